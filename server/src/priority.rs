//! Which threads step back where cores are short: worlds keep their pace, and pictures and answers come a little later.
//!
//! On Linux and Android a thread has a niceness of its own, which threads that it starts inherit; nobody may lower it again, so whatever starts a
//! world is kept free of it. On other systems the call does nothing: macOS knows classes of service and Windows priorities,
//! neither of which could be tried here.

/// Niceness of threads that serve: requests, sockets, coding of volumes, samples. Beside one of them a world's thread gets three quarters of a core.
pub const SERVING: i32 = 5;
/// Niceness of threads that draw. Beside one of them a world's thread gets nine tenths of a core.
pub const DRAWING: i32 = 10;

/// Makes the calling thread so much nicer than the program's first one, for good; what it starts afterwards is too. Where the system refuses, it stays as it
/// was, and the log says so.
pub fn step_back(niceness: i32) {
    #[cfg(any(target_os = "linux", target_os = "android"))]
    {
        use rustix::process::{getpid, getpriority_process, setpriority_process};
        // With a thread's number the system means that thread, and the first one's is the program's.
        let set =
            getpriority_process(Some(getpid())).and_then(|base| setpriority_process(None, (base + niceness).min(19)));
        if let Err(error) = set {
            tracing::debug!(%error, niceness, "a thread's priority stays as it was");
        }
    }
    #[cfg(not(any(target_os = "linux", target_os = "android")))]
    let _ = niceness;
}
