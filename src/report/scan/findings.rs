//! What is wrong with the scanned replica: mirrored, scaled, moved, too high or too low, closed, incomplete, or more than it should be.

use super::compare::shared_out;
use super::ends::ends;
use super::material::{Difference, Named, Slack, What, differences};
use super::{ScanGate, Scanned};
use crate::geom::Vector2;
use crate::progress::{Cancelled, Task};
use crate::report::anatomy::{Branches, StageLumina};
use crate::report::faults::{Ends, Made, Place, Size, StagePair, moved, plugged};
use crate::report::{BodyKind, Finding, Kind, Stage};

/// Smaller deviations of outlines are none, mm, or this part of a voxel.
const LEAST_MM: f64 = 0.06;
const LEAST_VOXEL: f64 = 0.25;
/// A lumen is plugged where this part of it is filled; otherwise there is no replica.
const FILLED: f64 = 0.5;
/// How many standard deviations of the pose are given away.
const POSE_SD: f64 = 2.0;

impl Scanned<'_> {
    /// All findings of the stage.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub(in crate::report) fn findings(
        &self,
        solid: &StageLumina,
        branches: &Branches,
        task: &Task<'_>,
    ) -> Result<Vec<Finding>, Cancelled> {
        if self.registered.is_mirrored() {
            return Ok(vec![self.mirrored(branches.z_mm())]);
        }
        let mut findings = self.of_outlines(solid, branches);
        let named = Named { branches, solid };
        let slack = |z_mm: f64| self.slack(&findings, z_mm);
        let pose = self.pose();
        let of_material = differences(&self.reader, pose, named, &slack, task)?;
        let told: Vec<Finding> = of_material
            .iter()
            .map(|d| self.of_material(d, branches))
            .filter(|f| !findings.iter().any(|g| g.kind == Kind::Plugged && explains(g, f)))
            .collect();
        findings.extend(told);
        if self.too_coarse().is_some() {
            findings.iter_mut().for_each(|f| f.judged = false);
        }
        Ok(findings)
    }

    fn whole(&self, kind: Kind, z_mm: &[f64], text: String) -> Finding {
        Finding {
            stage: Stage::Scan.name(),
            kind,
            place: Place::of_planes(z_mm, 0, z_mm.len() - 1),
            size: None,
            vector_mm: None,
            beyond_gate: true,
            judged: true,
            text: format!("scan: {text}"),
        }
    }

    fn mirrored(&self, z_mm: &[f64]) -> Finding {
        let text = format!(
            "the scan is a mirror image of the model: mirrored it fits to {:.3} mm, as it is to {:.3} mm; either the replica was printed mirrored, or the scan was exported so",
            self.registered.mirrored_off_mm, self.registered.off_mm
        );
        self.whole(Kind::Mirrored, z_mm, text)
    }

    /// What the outlines of the lumina and the ends tell, the scale taken away first.
    fn of_outlines(&self, solid: &StageLumina, branches: &Branches) -> Vec<Finding> {
        let z_mm = branches.z_mm();
        let gate = self.gate();
        let tested = shared_out(self.unscaled.as_ref().unwrap_or(&self.planes), branches);
        let [low, high] = self.reader.inputs.solid.z_range_mm();
        let ends_mm = self
            .levels
            .and_then(|_| ends(&self.reader, self.pose()))
            .map(|found| Ends { found, meant: [low, high] });
        let pair = StagePair {
            stage: Stage::Scan,
            reference: &solid.planes,
            tested: &tested.planes,
            meant_mm: 0.0,
            least_mm: LEAST_MM.max(LEAST_VOXEL * self.largest_mm()),
            gate_mm: gate.outline_mm,
            gate_percent: Some(gate.scale_percent),
            told_mm: 0.5 * self.largest_mm(),
            // A part that is stretched is off evenly at both ends; one that lacks layers is not.
            ends_mm: ends_mm.filter(is_even),
        };
        let mut findings = Vec::new();
        if let Some(percent) = self.registered.scaled_percent() {
            let size = Size { size: percent, unit: "percent", uncertainty: 100.0 * self.registered.scale_sd };
            let text = format!("the scanned replica is scaled by {percent:+.2} % against the solid");
            let found = Finding { size: Some(size), ..self.whole(Kind::Scaled, z_mm, text) };
            findings.push(pair.judged_part(found, percent, high - low));
        }
        let names = branches.names();
        findings.extend(moved(&pair, &names, z_mm));
        if let Some(ends) = ends_mm.filter(|_| findings.iter().all(|f| f.kind != Kind::Stretched)) {
            findings.extend((0..2).filter_map(|i| self.end(&pair, ends, i, z_mm)));
        }
        let made = [Made { stage: Stage::Scan, lumina: &tested.planes }];
        let is_filled = |f: &Finding| {
            let [first, last] = f.place.planes.unwrap_or_default();
            self.reader.inputs.body == BodyKind::Cast
                || (first..=last).any(|k| self.fills(k, solid, branches, f))
        };
        findings.extend(plugged(&solid.planes, &made, &names, z_mm).into_iter().filter(is_filled));
        findings
    }

    /// An end that lies beside its height by more than an outline may, and than half of what a part may shrink.
    fn end(&self, pair: &StagePair<'_>, ends: Ends, i: usize, z_mm: &[f64]) -> Option<Finding> {
        let off_mm = ends.found[i] - ends.meant[i];
        let height_mm = ends.meant[1] - ends.meant[0];
        let least_mm = pair.least_mm.max(POSE_SD * self.registered.pose_mm);
        let allowed_mm = pair.gate_mm.max(0.005 * pair.gate_percent.unwrap_or(0.0) * height_mm);
        let uncertainty = self.place_mm();
        (off_mm.abs() > least_mm).then(|| {
            let which = ["lower", "upper"][i];
            let way = if off_mm > 0.0 { "higher" } else { "lower" };
            let text = format!(
                "the {which} end of the scanned replica lies {:.3} mm {way} than that of the solid, at z {:.2} mm",
                off_mm.abs(),
                ends.found[i]
            );
            let plane = if i == 0 { 0 } else { z_mm.len() - 1 };
            let place = Place { z_mm: Some([ends.found[i], ends.meant[i]]), ..Place::of_planes(z_mm, plane, plane) };
            let beyond_gate = off_mm.abs() > allowed_mm;
            Finding {
                place,
                size: Some(Size { size: off_mm, unit: "mm", uncertainty }),
                beyond_gate,
                judged: !beyond_gate || off_mm.abs() > pair.told_mm,
                ..self.whole(Kind::WrongHeight, z_mm, text)
            }
        })
    }

    /// Whether material fills the lumen of a finding's branch in a plane.
    fn fills(&self, k: usize, solid: &StageLumina, branches: &Branches, finding: &Finding) -> bool {
        let branch = branches.names().iter().position(|n| Some(n) == finding.place.branch.as_ref());
        let section = self.reader.sections[k].1;
        let lumen = branch.and_then(|b| solid.planes[k][b].as_ref()).unwrap_or(&section.lumen);
        let area = lumen.area_mm2();
        area > 0.0 && self.planes[k].material.intersection(lumen).area_mm2() > FILLED * area
    }

    /// How outlines may lie off at a height without being a difference of material: what the gate allows, what voxels and pose
    /// do not tell; and what was found of the outlines there. `None` at an end that lies off.
    fn slack(&self, findings: &[Finding], z_mm: f64) -> Option<Slack> {
        let allowed_mm =
            self.gate().outline_mm.max(0.5 * self.largest_mm()) + POSE_SD * self.registered.pose_mm;
        let [low, high] = self.reader.inputs.solid.z_range_mm();
        let at_end = |f: &Finding| match (f.kind, f.size) {
            (Kind::Stretched, Some(size)) => 0.005 * size.size.abs() * (high - low),
            (Kind::WrongHeight, Some(size)) => size.size.abs(),
            _ => 0.0,
        };
        let ends_mm = findings.iter().map(at_end).fold(0.0, f64::max) + allowed_mm;
        if z_mm < low + ends_mm || z_mm > high - ends_mm {
            return None;
        }
        let half_mm = 0.5 * self.reader.interval_mm() + 1e-6;
        let covers = |f: &&Finding| {
            f.place.z_mm.is_some_and(|[low, high]| (low - half_mm..=high + half_mm).contains(&z_mm))
        };
        let here = || findings.iter().filter(covers);
        let offsets = here().filter(|f| f.kind == Kind::BoundaryMoved).filter_map(|f| f.size);
        let offset_mm = offsets.map(|s| s.size.abs()).fold(0.0, f64::max);
        let shifts = || here().filter_map(|f| Some((f.vector_mm?, &f.place.branch)));
        let mut shifts_mm: Vec<Vector2> = shifts().map(|([x, y], _)| Vector2::new(x, y)).collect();
        // What holds for one branch leaves the others where they are.
        if shifts().any(|(_, branch)| branch.is_some()) {
            shifts_mm.push(Vector2::zeros());
        }
        Some(Slack { allowed_mm, offset_mm, shifts_mm })
    }

    fn of_material(&self, difference: &Difference, branches: &Branches) -> Finding {
        let z_mm = branches.z_mm();
        let [low, high] = difference.z_mm;
        let planes: Vec<usize> = (0..z_mm.len()).filter(|&k| (low..=high).contains(&z_mm[k])).collect();
        let branch = difference.branch.map(|b| branches.names()[b].clone());
        let among = branch.as_ref().map_or_else(String::new, |b| format!(", {b}"));
        let where_at =
            format!("z {low:.2} to {high:.2} mm (x {:.1}, y {:.1}){among}", difference.at.x, difference.at.y);
        let (volume, area) = (difference.volume_mm3, difference.area_mm2);
        let size = format!("{volume:.2} mm\u{b3}, up to {area:.2} mm\u{b2} of a section");
        let (kind, beyond_gate, text) = match difference.what {
            What::Missing if difference.is_whole => {
                let name = branch.as_deref().unwrap_or("the vessel");
                let text = format!(
                    "{name} is missing from z {low:.2} to {high:.2} mm: {size} of its wall are not there"
                );
                (Kind::MissingMaterial, true, text)
            }
            What::Missing => {
                (Kind::MissingMaterial, true, format!("material is missing: {size}, {where_at}"))
            }
            What::InLumen => {
                (Kind::MaterialInLumen, true, format!("material lies in the lumen: {size}, {where_at}"))
            }
            What::Outside => {
                let text = format!("material lies outside of the model: {size}, {where_at}");
                (Kind::MaterialOutside, volume > self.reader.inputs.gate.extra_mm3, text)
            }
        };
        // The surface of a cube of this volume, off by what a place is uncertain.
        let uncertainty = 6.0 * volume.powf(2.0 / 3.0) * self.place_mm();
        Finding {
            place: Place {
                layers: None,
                planes: planes.first().zip(planes.last()).map(|(&a, &b)| [a, b]),
                z_mm: Some([low, high]),
                branch,
            },
            size: Some(Size { size: volume, unit: "mm3", uncertainty }),
            beyond_gate,
            ..self.whole(kind, z_mm, text)
        }
    }
}

/// Whether both ends lie off by about as much, and opposite ways.
fn is_even(Ends { found, meant }: &Ends) -> bool {
    let [below, above] = [0, 1].map(|i| found[i] - meant[i]);
    (above + below).abs() < 0.4 * (above - below).abs()
}

/// Whether a closed branch is what the material in its lumen is.
fn explains(plugged: &Finding, found: &Finding) -> bool {
    let planes = plugged.place.planes.zip(found.place.planes);
    found.kind == Kind::MaterialInLumen
        && planes.is_some_and(|(a, b)| a[0] <= b[1] && b[0] <= a[1])
        && (found.place.branch.is_none() || found.place.branch == plugged.place.branch)
}

impl ScanGate {
    /// The profile's limits; 0.5 % is what plastics shrink beyond what is compensated.
    pub(super) const fn of(gate: &crate::profile::Gate) -> Self {
        Self { p95_mm: gate.total_p95_mm, outline_mm: gate.outline_mm, scale_percent: 0.5 }
    }
}
