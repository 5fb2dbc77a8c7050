//! The figures of a stage, branch by branch.
//!
//! Every place at which a distance was taken belongs to one branch: the one whose contour in that plane is nearest. So the
//! samples of all branches together are those of the stage. Areas are those of the pieces of both lumina that
//! the branch has ([`Branches::share_out`]); where a plane has one branch only, those of the plane.

use super::anatomy::{Branches, StageLumina};
use super::deviation::{Areas, Comparison, Figures};
use crate::geom::SegmentIndex;
use rayon::prelude::*;
use serde::Serialize;

/// The figures of one branch in one stage.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct BranchFigures {
    /// The branch.
    pub branch: String,
    /// Planes that have figures.
    pub n_planes: usize,
    /// The figures; Dice and area are those of the lumen.
    #[serde(flatten)]
    pub figures: Figures,
}

/// What a stage compares: the distances of every plane, and the lumina of both sides.
#[derive(Clone, Copy)]
pub(super) struct Compared<'a> {
    pub(super) planes: &'a [Option<&'a Comparison>],
    pub(super) reference: &'a StageLumina,
    pub(super) tested: &'a StageLumina,
}

/// The comparisons of every branch, plane by plane, in the order of the branches.
pub(super) fn by_branch(branches: &Branches, stage: Compared<'_>) -> Vec<Vec<Comparison>> {
    let of_plane = |(k, comparison): (usize, &Option<&Comparison>)| {
        comparison.map_or_else(Vec::new, |whole| shared(branches, stage, k, whole))
    };
    let planes: Vec<Vec<(usize, Comparison)>> = stage.planes.par_iter().enumerate().map(of_plane).collect();
    let mut all = vec![Vec::new(); branches.names().len()];
    for (branch, comparison) in planes.into_iter().flatten() {
        all[branch].push(comparison);
    }
    all
}

/// A plane's comparison, shared out among the branches that run through it.
fn shared(
    branches: &Branches,
    stage: Compared<'_>,
    k: usize,
    whole: &Comparison,
) -> Vec<(usize, Comparison)> {
    let own = branches.at(k);
    if let [(branch, _)] = own[..] {
        return vec![(branch, whole.clone())];
    }
    let indices: Vec<Option<SegmentIndex>> =
        own.iter().map(|(_, lumen)| SegmentIndex::try_new(&lumen.contours)).collect();
    let mut parts: Vec<(usize, Comparison)> =
        own.iter().map(|(branch, _)| (*branch, Comparison::default())).collect();
    for (&distance_mm, &place) in whole.distances_mm.iter().zip(&whole.places) {
        let off = |i: &usize| indices[*i].as_ref().map_or(f64::INFINITY, |x| x.nearest(place).distance_mm);
        if let Some(nearest) = (0..parts.len()).min_by(|a, b| off(a).total_cmp(&off(b))) {
            parts[nearest].1.distances_mm.push(distance_mm);
            parts[nearest].1.places.push(place);
        }
    }
    parts.retain(|(_, part)| !part.distances_mm.is_empty());
    for (branch, part) in &mut parts {
        let lumen = |side: &StageLumina| side.planes[k][*branch].clone().unwrap_or_default();
        part.areas = whole.areas.map(|_| Areas::of(&lumen(stage.reference), &lumen(stage.tested)));
    }
    parts
}
