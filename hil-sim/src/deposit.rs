//! Executed moves to beads: what lies on the bed, where, how wide and how high.
//!
//! The recorder watches the nozzle, not the comments of the G-code. A move lays a bead where it pushes filament beyond what
//! has ever been pushed: a retraction and the push that makes up for it lay nothing. The bead's volume is that filament
//! times the filament's cross-section; its width follows from volume, length and height by the machine's bead model. A
//! layer is a height at which beads are laid; its height above what lies below is the distance to the last lower layer (to
//! the bed for the lowest). What is extruded on the spot, or in the air along z only, is a blob: it is counted, but no bead.
//! All mm, bed frame.

use crate::{
    event::Bead,
    planner::Block,
    profile::{BeadShape, Profile},
    whole,
};

/// Less filament than this is rounding, not extrusion, mm.
const LEAST_FILAMENT_MM: f64 = 1e-6;
/// Heights are compared in whole µm.
const MICROMETRES_PER_MM: f64 = 1000.0;
/// A leaking nozzle reaches what lies this far below it, mm.
const LEAK_REACH_MM: f64 = 1.0;

/// Finds layers from the heights at which beads are laid, in the order in which they are laid.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    /// Heights in µm, rising: the layers below the present one, and that one.
    stack: Vec<i64>,
    seen: usize,
}

impl Layers {
    /// A bead is laid at `z_mm`: the index of its layer, counted from 0, if that layer begins with it.
    pub fn visit(&mut self, z_mm: f64) -> Option<usize> {
        let z = whole::to_i64(z_mm * MICROMETRES_PER_MM);
        if self.stack.last() == Some(&z) {
            return None;
        }
        while self.stack.last().is_some_and(|&top| top >= z) {
            self.stack.pop();
        }
        self.stack.push(z);
        self.seen = self.seen.max(self.stack.len());
        self.current()
    }

    /// The layer that is being printed, counted from 0.
    #[must_use]
    pub fn current(&self) -> Option<usize> {
        self.stack.len().checked_sub(1)
    }

    /// Most layers above each other so far.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.seen
    }

    /// Height of the present layer above the last lower one.
    #[must_use]
    pub fn height_mm(&self) -> f64 {
        let top = self.stack.last().copied().unwrap_or(0);
        let below = self.stack.iter().rev().nth(1).copied().unwrap_or(0);
        (top - below) as f64 / MICROMETRES_PER_MM
    }

    fn top_mm(&self) -> Option<f64> {
        self.stack.last().map(|&z| z as f64 / MICROMETRES_PER_MM)
    }
}

/// What a move left behind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Laid {
    /// Nothing.
    Nothing,
    /// A bead.
    Bead(Bead),
    /// So many mm³ on the spot.
    Blob(f64),
}

/// The nozzle as the recorder sees it.
#[derive(Debug, Clone)]
pub struct Deposit {
    /// Layers found so far.
    pub layers: Layers,
    /// Filament pushed, net of retractions.
    pub net_mm: f64,
    most_mm: f64,
    filament_area_mm2: f64,
    shape: BeadShape,
    last_area_mm2: f64,
    /// How far the axes have slipped.
    pub shift_mm: [f64; 3],
    /// Which part of what is pushed comes out: 1 unless clogged.
    pub yield_share: f64,
    /// Filament before its end, mm.
    pub left_mm: f64,
    /// Which part of the last bead's cross-section drips on travel moves.
    pub leak_share: f64,
}

impl Deposit {
    /// A clean bed under `profile`'s nozzle.
    #[must_use]
    pub fn new(profile: &Profile) -> Self {
        Self {
            layers: Layers::default(),
            net_mm: 0.0,
            most_mm: 0.0,
            filament_area_mm2: profile.filament_area_mm2(),
            shape: profile.bead_shape,
            last_area_mm2: 0.0,
            shift_mm: [0.0; 3],
            yield_share: 1.0,
            left_mm: f64::INFINITY,
            leak_share: 0.0,
        }
    }

    /// A move starts; the index of the layer that begins with it, if one does.
    pub fn begin(&mut self, block: &Block) -> Option<usize> {
        let pushes = self.net_mm + block.to[3] - block.from[3] > self.most_mm + LEAST_FILAMENT_MM;
        if pushes && is_level(block) { self.layers.visit(block.to[2] + self.shift_mm[2]) } else { None }
    }

    /// A move has been driven from `block.from` to `block.to`.
    pub fn finish(&mut self, block: &Block, t_s: f64, hotend_c: f64) -> Laid {
        let pulled = block.to[3] - block.from[3];
        let before = self.net_mm;
        self.net_mm += pulled;
        let fresh = self.net_mm - self.most_mm;
        if fresh <= LEAST_FILAMENT_MM {
            return self.leak(block, t_s, hotend_c);
        }
        let from_share = ((self.most_mm - before) / pulled).clamp(0.0, 1.0);
        self.most_mm = self.net_mm;
        let there_mm = fresh.min(self.left_mm);
        self.left_mm -= there_mm;
        let volume = there_mm * self.filament_area_mm2 * self.yield_share;
        let start = block.at(from_share);
        let length = distance(&start, &block.to);
        if length < 1e-9 {
            return Laid::Blob(volume);
        }
        if volume <= 0.0 {
            return Laid::Nothing;
        }
        self.last_area_mm2 = volume / length;
        self.bead([start, block.to], volume / length, t_s, hotend_c)
    }

    fn leak(&self, block: &Block, t_s: f64, hotend_c: f64) -> Laid {
        let area = self.leak_share * self.last_area_mm2;
        let near =
            self.layers.top_mm().is_some_and(|top| block.to[2] + self.shift_mm[2] < top + LEAK_REACH_MM);
        if area > 0.0 && near && is_level(block) {
            self.bead([block.from, block.to], area, t_s, hotend_c)
        } else {
            Laid::Nothing
        }
    }

    fn bead(&self, [from, to]: [[f64; 4]; 2], area_mm2: f64, t_s: f64, hotend_c: f64) -> Laid {
        let height_mm = self.layers.height_mm();
        if height_mm <= 0.0 {
            return Laid::Blob(area_mm2 * distance(&from, &to));
        }
        let place = |at: &[f64; 4]| std::array::from_fn(|axis| at[axis] + self.shift_mm[axis]);
        Laid::Bead(Bead {
            t_s,
            from_mm: place(&from),
            to_mm: place(&to),
            volume_mm3: area_mm2 * distance(&from, &to),
            width_mm: self.shape.width_mm(area_mm2, height_mm),
            height_mm,
            hotend_c,
        })
    }
}

fn distance(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    a[..3].iter().zip(&b[..3]).map(|(a, b)| (b - a).powi(2)).sum::<f64>().sqrt()
}

/// Whether a move goes along the layer.
fn is_level(block: &Block) -> bool {
    let sideways = (block.to[0] - block.from[0]).hypot(block.to[1] - block.from[1]);
    sideways > 1e-9 && (block.to[2] - block.from[2]).abs() < 0.5 / MICROMETRES_PER_MM
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::{Limits, Planner};

    const LIMITS: Limits = Limits {
        max_speed: [500.0; 4],
        max_acceleration: [3000.0; 4],
        print_acceleration: 1000.0,
        retract_acceleration: 1000.0,
        travel_acceleration: 1000.0,
        travel_max_acceleration: None,
        cornering: crate::planner::Cornering::Deviation(0.013),
    };

    /// Drives through `points` and gives what each move left.
    fn lay(deposit: &mut Deposit, points: &[[f64; 4]]) -> Vec<Laid> {
        points
            .windows(2)
            .map(|pair| {
                let mut planner = Planner::new(4);
                planner.push(0.0, [pair[0], pair[1]], 50.0, &LIMITS);
                let block = *planner.start().unwrap();
                deposit.begin(&block);
                deposit.finish(&block, 0.0, 200.0)
            })
            .collect()
    }

    fn nozzle() -> Deposit {
        Deposit::new(&Profile::by_name("reference").unwrap())
    }

    fn bead(laid: &Laid) -> Bead {
        match laid {
            Laid::Bead(bead) => *bead,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn flow_of_width_height_length_gives_that_width() {
        let mut nozzle = nozzle();
        let e = 0.4 * 0.2 * 10.0 / nozzle.filament_area_mm2;
        let laid = lay(&mut nozzle, &[[0.0, 0.0, 0.2, 0.0], [10.0, 0.0, 0.2, e]]);
        let bead = bead(&laid[0]);
        assert!((bead.width_mm - 0.4).abs() < 1e-9 && (bead.height_mm - 0.2).abs() < 1e-12, "{bead:?}");
        assert!((bead.volume_mm3 - 0.8).abs() < 1e-12);
    }

    #[test]
    fn retraction_and_its_make_up_lay_nothing() {
        let mut nozzle = nozzle();
        let laid = lay(
            &mut nozzle,
            &[
                [0.0, 0.0, 0.2, 0.0],
                [10.0, 0.0, 0.2, 0.4],
                [10.0, 0.0, 0.2, -0.4],
                [50.0, 0.0, 0.2, -0.4],
                [50.0, 0.0, 0.2, 0.4],
                [60.0, 0.0, 0.2, 0.8],
            ],
        );
        assert_eq!(laid[1..4], [Laid::Nothing; 3]);
        assert!((bead(&laid[4]).volume_mm3 - bead(&laid[0]).volume_mm3).abs() < 1e-12);
        assert!((nozzle.net_mm - 0.8).abs() < 1e-12);
    }

    #[test]
    fn only_what_exceeds_the_retraction_is_laid() {
        let mut nozzle = nozzle();
        let points =
            [[0.0, 0.0, 0.2, 0.0], [10.0, 0.0, 0.2, 1.0], [10.0, 0.0, 0.2, 0.5], [20.0, 0.0, 0.2, 1.5]];
        let laid = lay(&mut nozzle, &points);
        let bead = bead(&laid[2]);
        assert!((bead.from_mm[0] - 15.0).abs() < 1e-9 && (bead.to_mm[0] - 20.0).abs() < 1e-12, "{bead:?}");
    }

    #[test]
    fn push_on_the_spot_is_a_blob() {
        let mut nozzle = nozzle();
        let laid = lay(&mut nozzle, &[[0.0, 0.0, 0.2, 0.0], [0.0, 0.0, 0.2, 1.0]]);
        assert!(matches!(laid[0], Laid::Blob(volume) if (volume - nozzle.filament_area_mm2).abs() < 1e-12));
    }

    #[test]
    fn height_is_the_distance_to_the_last_lower_layer() {
        let mut layers = Layers::default();
        // A prime line at 0.3, then layers of 0.2; a hop back down begins another object.
        for (z, index, height) in
            [(0.3, 0, 0.3), (0.2, 0, 0.2), (0.4, 1, 0.2), (0.55, 2, 0.15), (0.2, 0, 0.2), (0.45, 1, 0.25)]
        {
            assert_eq!(layers.visit(z), Some(index));
            assert!((layers.height_mm() - height).abs() < 1e-12, "{z}");
            assert_eq!(layers.visit(z), None);
        }
        assert_eq!(layers.count(), 3);
    }

    #[test]
    fn faults_of_the_nozzle_show() {
        let mut nozzle = nozzle();
        let line = [[0.0, 0.0, 0.2, 0.0], [10.0, 0.0, 0.2, 0.4]];
        let clean = bead(&lay(&mut nozzle, &line)[0]);
        nozzle.net_mm = 0.0;
        nozzle.most_mm = 0.0;
        nozzle.yield_share = 0.8;
        nozzle.shift_mm = [0.4, 0.0, 0.0];
        let faulty = bead(&lay(&mut nozzle, &line)[0]);
        assert!((faulty.volume_mm3 / clean.volume_mm3 - 0.8).abs() < 1e-12);
        assert!((faulty.from_mm[0] - 0.4).abs() < 1e-12 && (faulty.to_mm[0] - 10.4).abs() < 1e-12);
        nozzle.leak_share = 0.25;
        let travel = [[10.0, 0.0, 0.2, 0.4], [30.0, 0.0, 0.2, 0.4]];
        let drip = bead(&lay(&mut nozzle, &travel)[0]);
        assert!((drip.width_mm - 0.25 * faulty.width_mm).abs() < 1e-12, "{drip:?}");
    }
}
