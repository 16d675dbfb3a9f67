// Physical constants alone: all of them are generated.
