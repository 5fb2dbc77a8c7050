//! The lumen's skin: through the contours of the CT planes, events on fitted lobe fields.

use super::Error;
use super::assemble::{Recipe, assemble};
use super::distance::{DistanceSource, Inverse};
use super::event::{EventPlanes, EventSource, Plane};
use super::lobes::LobeSource;
use super::skin::{Correspondence, Skin};
use crate::ct::Warning;
use crate::geom::Contour;
use crate::progress::Task;
use crate::topology::Graph;

struct Lumen {
    correspondence: Correspondence,
}

fn boxed<'a>(source: impl EventSource + 'a) -> Box<dyn EventSource + 'a> {
    Box::new(source)
}

fn all_planes(planes: &EventPlanes) -> impl Iterator<Item = &Plane> {
    planes.parents.iter().chain(&planes.daughters)
}

/// Holes as outlines.
fn reversed(planes: &EventPlanes) -> EventPlanes {
    let plane = |p: &Plane| Plane { w: p.w, contours: p.contours.iter().map(Contour::reversed).collect() };
    EventPlanes {
        parents: planes.parents.iter().map(plane).collect(),
        daughters: planes.daughters.iter().map(plane).collect(),
        beyond: None,
        rejoined: planes.rejoined.iter().map(plane).collect(),
    }
}

impl Recipe for Lumen {
    fn source<'a>(&'a self, planes: &EventPlanes, _sign: f64) -> Option<Box<dyn EventSource + 'a>> {
        let is_hole = |c: &Contour| !c.is_ccw();
        if !planes.daughters.iter().flat_map(|p| &p.contours).any(is_hole) {
            LobeSource::fit(planes).map(boxed)
        } else if all_planes(planes).flat_map(|p| &p.contours).all(is_hole) {
            LobeSource::fit(&reversed(planes)).map(|s| boxed(Inverse(s)))
        } else {
            DistanceSource::through(planes).map(boxed)
        }
    }

    fn second_source<'a>(&'a self, planes: &EventPlanes) -> Option<Box<dyn EventSource + 'a>> {
        DistanceSource::through(planes).map(boxed)
    }

    fn is_measured(&self) -> bool {
        true
    }

    fn correspondence(&self) -> Correspondence {
        self.correspondence
    }
}

/// Builds the lumen's skin from the graph of its contours; with what was decided by rule.
pub(super) fn build(
    graph: &Graph,
    correspondence: Correspondence,
    task: &Task<'_>,
) -> Result<(Skin, Vec<Warning>), Error> {
    assemble(graph, &Lumen { correspondence }, task)
}
