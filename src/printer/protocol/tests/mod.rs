mod desk;
mod firmware;
mod holds;
mod noise;
mod pair;
mod random;
mod states;
mod waits;
