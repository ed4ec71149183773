//! Reports and plots
