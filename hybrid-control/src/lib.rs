//! Steering laws: tasks, priorities, duty cycling, estimation.
