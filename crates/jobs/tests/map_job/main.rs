//! The job `map` on an engine in closed form whose optimum is known, and on beds that fail.

mod day;
mod engine;
mod faults;
mod maps;
mod more;
mod optimum;
mod ways;
