//! The application: configuration, cycle, run, experiments, command line.
