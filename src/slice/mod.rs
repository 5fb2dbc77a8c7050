//! Layers on the CT-aligned grid, cut from the exact solid.
//!
//! All coordinates are in the stack frame; the toolpath stage puts them on the bed.

use crate::geom::Region;
use serde::{Deserialize, Serialize};

/// One layer of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LayerSlot {
    /// Height of the layer's middle in the stack frame, mm: where the solid is cut.
    pub z_mid_mm: f64,
    /// Thickness of the layer, mm.
    pub height_mm: f64,
    /// The CT plane whose middle this layer's middle is, counted from 0 in the sections.
    pub ct_plane: Option<usize>,
}

/// The table layer <-> z <-> CT plane, from the bed upward.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LayerGrid {
    /// The layers, from the bed upward; each begins where the one below ends.
    pub slots: Vec<LayerSlot>,
}

/// A layer of the part: what is to be filled with material.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Its place in the grid.
    pub slot: LayerSlot,
    /// What is to be filled; the lumen is its holes (a hollow wall) or all of it (a cast). Stack frame.
    pub material: Region,
    /// The lumen, for reports and for keeping beads and travels out of it; empty for a cast. Stack frame.
    pub lumen: Region,
}
