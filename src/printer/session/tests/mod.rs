//! Sessions against the simulated printer, in one process and on its clock.

mod certain;
mod crash;
mod deposit;
mod heights;
mod hold;
mod matrix;
mod policy;
mod rate;
mod reattach;
mod rig;
mod uncounted;
mod vessel;
