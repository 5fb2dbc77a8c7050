//! Bodies with closed forms, for the tests of this stage and of those behind it.

use crate::geom::{Contour, Point2, Region};
use crate::solid::{CrossSection, Sectioned};

/// A straight tube, or a cone, whose every horizontal section is a circle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tube {
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Radius of the lumen, mm.
    pub(crate) radius: f64,
    /// Shift of the centre per mm of height.
    pub(crate) slope: [f64; 2],
    /// Growth of the radius per mm of height.
    pub(crate) flare: f64,
}

impl Tube {
    pub(crate) fn upright(x: f64, radius: f64) -> Self {
        Self { x, y: 0.0, radius, slope: [0.0, 0.0], flare: 0.0 }
    }

    fn disk(&self, z: f64, grown: f64, tolerance_mm: f64) -> Region {
        let radius = self.radius + self.flare * z + grown;
        let step = 2.0 * (1.0 - tolerance_mm / radius).acos();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few hundred")]
        let n = (std::f64::consts::TAU / step).ceil() as usize;
        let centre = Point2::new(self.x + self.slope[0] * z, self.y + self.slope[1] * z);
        Region::new(vec![Contour::circle(centre, radius, n)])
    }
}

/// The union of tubes with a common wall (0: a cast).
#[derive(Debug)]
pub(crate) struct Tubes {
    tubes: Vec<Tube>,
    wall_mm: f64,
    z_range_mm: [f64; 2],
}

impl Tubes {
    pub(crate) fn new(tubes: Vec<Tube>, wall_mm: f64, z_range_mm: [f64; 2]) -> Self {
        Self { tubes, wall_mm, z_range_mm }
    }

    /// Two tubes that lean towards each other and become one.
    pub(crate) fn merging(z_range_mm: [f64; 2]) -> Self {
        let at = |side: f64| Tube { slope: [-side * 0.22, 0.05], ..Tube::upright(side * 5.2, 2.6) };
        Self::new(vec![at(-1.0), at(1.0)], 1.0, z_range_mm)
    }

    fn union(&self, z: f64, grown: f64, tolerance_mm: f64) -> Region {
        let disks: Vec<Region> = self.tubes.iter().map(|t| t.disk(z, grown, tolerance_mm)).collect();
        if disks.len() == 1 { disks[0].clone() } else { Region::union_all(&disks) }
    }
}

impl Sectioned for Tubes {
    fn z_range_mm(&self) -> [f64; 2] {
        self.z_range_mm
    }

    fn section(&self, z_mm: f64, tolerance_mm: f64) -> CrossSection {
        if self.wall_mm <= 0.0 {
            return CrossSection { outer: self.union(z_mm, 0.0, tolerance_mm), lumen: Region::default() };
        }
        CrossSection {
            outer: self.union(z_mm, self.wall_mm, tolerance_mm),
            lumen: self.union(z_mm, 0.0, tolerance_mm),
        }
    }
}
