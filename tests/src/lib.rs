//! Welkin's tests live beside this file, one folder a kind; this library is empty on purpose.
