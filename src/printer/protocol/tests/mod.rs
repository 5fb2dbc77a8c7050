mod firmware;
mod noise;
mod pair;
mod states;
