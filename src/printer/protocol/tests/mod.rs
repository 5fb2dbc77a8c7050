mod firmware;
mod noise;
mod pair;
mod random;
mod states;
