use super::*;
use crate::geom::{Contour, Point2, Point3, RigidTransform};
use crate::phantom::{Kind, Vessel};
use crate::progress::Task;
use crate::sections::{PlaneSections, SectionStack};
use crate::solid::{Body, Crotch, Params, SkinChoice, Solid, build};

fn wall(planes: Vec<PlaneSections>) -> Solid {
    let stack = SectionStack { planes, patient_from_stack: RigidTransform::identity() };
    build(&stack, &Params::new(Body::Wall { wall_mm: 1.0 }), &Task::quiet()).unwrap().solid
}

fn pipe() -> Brep {
    let contours = vec![Contour::circle(Point2::new(5.0, 7.0), 3.0, 64)];
    let plane = |k: u32| PlaneSections { z_mm: 2.0 * f64::from(k), contours: contours.clone() };
    Brep::of(&wall((0..4).map(plane).collect()), SkinChoice::All)
}

/// A forked wall whose outer skin has a crease: there the top row of a lateral begins and ends at one vertex.
fn fork() -> Brep {
    let vessel = Vessel::new(Kind::Carotid);
    let plane = |k: u32| {
        let z_mm = 3.0 * f64::from(k);
        PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
    };
    let solid = wall((0..46).map(plane).collect());
    assert_eq!(solid.outer.as_ref().unwrap().slabs[0].crotch, Crotch::Crease);
    Brep::of(&solid, SkinChoice::All)
}

#[test]
fn a_pipe_is_one_solid_of_two_tubes_and_two_planes_and_the_bytes_repeat() {
    let text = to_step(&pipe());
    let count = |what: &str| text.matches(what).count();
    assert_eq!(count("=MANIFOLD_SOLID_BREP("), 1);
    assert_eq!(count("=B_SPLINE_SURFACE_WITH_KNOTS("), 2);
    assert_eq!(count("=PLANE("), 2);
    assert_eq!((count("=EDGE_CURVE("), count("=ORIENTED_EDGE(")), (6, 12));
    assert_eq!((count("=FACE_OUTER_BOUND("), count("=FACE_BOUND(")), (4, 2));
    assert!(text.contains("SI_UNIT(.MILLI.,.METRE.)") && text.ends_with("END-ISO-10303-21;\n"));
    assert_eq!(text, to_step(&pipe()));
}

#[test]
fn every_reference_names_an_entity_before_it() {
    for line in to_step(&pipe()).lines().filter(|l| l.starts_with('#')) {
        let mut numbers = line.split('#').skip(1).map(|part| {
            let digits: String = part.chars().take_while(char::is_ascii_digit).collect();
            digits.parse::<usize>().unwrap()
        });
        let own = numbers.next().unwrap();
        assert!(numbers.all(|n| n < own), "{line}");
    }
}

/// The entities of a file by their numbers.
struct Entries<'a>(Vec<&'a str>);

/// A parameter curve as it is read.
struct Trace {
    surface: usize,
    ends: Vec<[f64; 2]>,
    /// First and last knot, of it and of the curve in space.
    ranges: [[f64; 2]; 2],
}

impl<'a> Entries<'a> {
    fn of(text: &'a str) -> Self {
        Self(text.lines().filter(|l| l.starts_with('#')).map(|l| l.split_once('=').unwrap().1).collect())
    }

    fn at(&self, number: usize) -> &'a str {
        self.0[number - 1]
    }

    fn all(&self, kind: &str) -> Vec<usize> {
        (1..=self.0.len()).filter(|&n| self.at(n).split('(').next() == Some(kind)).collect()
    }

    fn references(&self, number: usize) -> Vec<usize> {
        let digits = |part: &str| part.chars().take_while(char::is_ascii_digit).collect::<String>();
        self.at(number).split('#').skip(1).map(|part| digits(part).parse().unwrap()).collect()
    }

    fn coordinates<const N: usize>(&self, point: usize) -> [f64; N] {
        let inner = self.at(point).rsplit('(').next().unwrap().trim_end_matches([')', ';']);
        inner.split(',').map(|x| x.parse().unwrap()).collect::<Vec<_>>().try_into().unwrap()
    }

    fn range(&self, spline: usize) -> [f64; 2] {
        let knots = self.at(spline).rsplit('(').next().unwrap().split(')').next().unwrap();
        let knots: Vec<f64> = knots.split(',').map(|x| x.parse().unwrap()).collect();
        [knots[0], *knots.last().unwrap()]
    }

    /// The edges of a face, a seam twice.
    fn edges(&self, face: usize) -> Vec<usize> {
        let bounds = self.references(face);
        let loops = bounds[..bounds.len() - 1].iter().flat_map(|&b| self.references(b));
        loops.flat_map(|l| self.references(l)).flat_map(|oriented| self.references(oriented)).collect()
    }

    fn traces(&self, edge: usize) -> Vec<Trace> {
        let parts = self.references(self.references(edge)[2]);
        let trace = |&p: &usize| {
            let [surface, representation] = self.references(p).try_into().unwrap();
            let line = self.references(representation)[0];
            let ends = self.references(line).into_iter().map(|point| self.coordinates(point)).collect();
            Trace { surface, ends, ranges: [line, parts[0]].map(|c| self.range(c)) }
        };
        parts[1..].iter().map(trace).collect()
    }

    fn vertices(&self, edge: usize) -> [Point3; 2] {
        let ends: [usize; 3] = self.references(edge).try_into().unwrap();
        [ends[0], ends[1]].map(|v| Point3::from(self.coordinates(self.references(v)[0])))
    }
}

/// Every use of an edge by a spline face has a parameter curve of the edge's range, whose ends lie at the edge's vertices.
fn assert_traced(brep: &Brep) {
    let text = to_step(brep);
    let file = Entries::of(&text);
    for (face, number) in brep.faces.iter().zip(file.all("ADVANCED_FACE")) {
        let Some(spline) = face.surface.spline() else { continue };
        let (edges, surface) = (file.edges(number), *file.references(number).last().unwrap());
        for &edge in &edges {
            let own: Vec<Trace> = file.traces(edge).into_iter().filter(|t| t.surface == surface).collect();
            assert_eq!(own.len(), edges.iter().filter(|&&e| e == edge).count(), "{}", file.at(edge));
            for trace in &own {
                assert_eq!(trace.ranges[0], trace.ranges[1], "{}", file.at(edge));
                let ends: [[f64; 2]; 2] = trace.ends.clone().try_into().unwrap();
                for ([u, v], vertex) in ends.into_iter().zip(file.vertices(edge)) {
                    let off_mm = (spline.at(u, v) - vertex).norm();
                    assert!(off_mm < 1e-5, "{off_mm} mm off {vertex} at ({u}, {v})");
                }
            }
            if let [first, second] = &own[..] {
                assert_ne!(first.ends, second.ends, "both sides of a seam");
            }
        }
    }
}

#[test]
fn every_edge_of_a_spline_face_has_a_trace_that_ends_at_its_vertices() {
    assert_traced(&pipe());
    assert_traced(&fork());
}

#[test]
fn a_seam_is_a_seam_curve_and_an_edge_of_two_faces_a_surface_curve() {
    let text = to_step(&pipe());
    assert_eq!((text.matches("=SEAM_CURVE(").count(), text.matches("=SURFACE_CURVE(").count()), (2, 4));
    assert_eq!(text.matches("=PCURVE(").count(), 2 * 2 + 4);
}
