//! Sessions against the simulated printer, in one process and on its clock.

mod crash;
mod matrix;
mod rate;
mod reattach;
mod rig;
