//! The lumen's skin: through the contours of the CT planes, events on fitted lobe fields.

use super::Error;
use super::assemble::{Recipe, assemble};
use super::distance::{DistanceSource, Inverse};
use super::event::{EventPlanes, EventSource, Plane};
use super::lobes::LobeSource;
use super::skin::{Correspondence, Skin};
use crate::ct::Warning;
use crate::geom::{Contour, SegmentIndex};
use crate::progress::Task;
use crate::topology::Graph;
use rayon::prelude::*;

/// Farthest that a contour may lie from the skin's section at its plane, mm; and the sections' chord tolerance.
const MOST_MISSED_MM: f64 = 1e-3;
const CHORD_MM: f64 = 1e-4;

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

/// Builds the lumen's skin from the graph of its contours, and makes sure that it runs through all that were given; with
/// what was decided by rule.
pub(super) fn build(
    graph: &Graph,
    correspondence: Correspondence,
    task: &Task<'_>,
) -> Result<(Skin, Vec<Warning>), Error> {
    let (skin, warnings) = assemble(graph, &Lumen { correspondence }, task)?;
    task.check()?;
    check_planes(graph, &skin)?;
    Ok((skin, warnings))
}

/// Refuses a skin that misses a contour, naming the lowest plane.
fn check_planes(graph: &Graph, skin: &Skin) -> Result<(), Error> {
    let missed = |(idx, given): (usize, &Option<usize>)| -> Option<Error> {
        let (plane, z_mm) = ((*given)?, graph.z_mm[idx]);
        let first = graph.nodes.partition_point(|n| n.plane < idx);
        let nodes = graph.nodes[first..].iter().take_while(|n| n.plane == idx);
        let index = SegmentIndex::try_new(&skin.section(z_mm, CHORD_MM));
        let distance_mm =
            |p| index.as_ref().map_or(f64::INFINITY, |index: &SegmentIndex| index.nearest(p).distance_mm);
        let off_mm = nodes.flat_map(|n| &n.contour.points).map(|p| distance_mm(*p)).fold(0.0, f64::max);
        (off_mm > MOST_MISSED_MM).then_some(Error::Missed { plane, z_mm, off_mm })
    };
    let first = graph.given.par_iter().enumerate().find_map_first(missed);
    first.map_or(Ok(()), Err)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Point2, RigidTransform};
    use crate::sections::{PlaneSections, SectionStack};
    use crate::topology::graph;

    #[test]
    fn a_skin_that_misses_a_contour_is_refused_with_its_plane() {
        let plane = |k: u32| PlaneSections {
            z_mm: 2.0 * f64::from(k),
            contours: vec![Contour::circle(Point2::new(0.1 * f64::from(k), 0.0), 3.0, 128)],
        };
        let stack = SectionStack {
            planes: (0..5).map(plane).collect(),
            patient_from_stack: RigidTransform::identity(),
        };
        let mut graph = graph(&stack).expect("a tube");
        let (skin, _) = build(&graph, Correspondence::default(), &Task::quiet()).expect("a tube");
        graph.nodes[3].contour.points[7].x += 2e-3;
        match check_planes(&graph, &skin) {
            Err(Error::Missed { plane: 3, z_mm, off_mm }) => {
                assert!(z_mm == 6.0 && (1e-3..2.1e-3).contains(&off_mm), "{off_mm}");
            }
            other => panic!("{other:?}"),
        }
    }
}
