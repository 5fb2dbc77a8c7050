//! Every kind of event, against closed forms and hand-made fields.

use super::*;
use crate::brep;
use crate::geom::{Bounds2, Vector2};
use crate::mesh::{SkinChoice, Tessellation, closedness, tessellate};
use crate::solid::grid::Jet;
use crate::solid::{iso, lumen};
use crate::topology::{Graph, Node, Star};

const PI: f64 = std::f64::consts::PI;

fn disk(x: f64, y: f64, radius: f64) -> Contour {
    Contour::circle(Point2::new(x, y), radius, 128)
}

fn planes(n: u32, step_mm: f64, contours: impl Fn(f64) -> Vec<Contour>) -> SectionStack {
    let plane = |k: u32| {
        let z_mm = step_mm * f64::from(k);
        PlaneSections { z_mm, contours: contours(z_mm) }
    };
    stack((0..n).map(plane).collect())
}

/// Closed, and through the given contours on every plane.
fn assert_sound(solid: &Solid, stack: &SectionStack) {
    for plane in &stack.planes {
        let section = solid.section(plane.z_mm, 1e-4).outer;
        let counts = (section.contours.len(), plane.contours.len());
        assert_eq!(counts.0, counts.1, "z {}, of {} planes", plane.z_mm, stack.planes.len());
        if !plane.contours.is_empty() {
            let off = farthest(&plane.region(), &section);
            assert!(off < 1e-3, "z {}: {off}", plane.z_mm);
        }
    }
    let how = Tessellation::within(0.05, SkinChoice::Lumen);
    let mesh = tessellate(solid, &how, &Task::quiet()).unwrap();
    assert!(closedness(&mesh).is_closed() && mesh.volume_mm3() > 0.0);
}

/// Disks that move apart from a common axis.
fn parting(n: u32, spread: impl Fn(f64) -> f64, radius: f64, z: f64) -> Vec<Contour> {
    let centre = |k: u32| {
        let (sin, cos) = (0.3 + 2.0 * PI * f64::from(k) / f64::from(n)).sin_cos();
        Point2::new(spread(z) * cos, spread(z) * sin)
    };
    let disks = (0..n).map(|k| Contour::circle(centre(k), radius, 256)).map(|c| Region::new(vec![c]));
    let regions: Vec<Region> = disks.collect();
    let joined = Region::union_all(&regions);
    // Without the creases that no smooth section follows.
    joined.contours.iter().filter(|c| c.is_ccw()).map(|c| c.resampled(48)).collect()
}

#[test]
fn branches_that_part_at_one_height_are_built() {
    for n in [2, 3, 4] {
        // Necks open between two planes; below them no gap reaches the axis.
        let spread = |z: f64| (2.0 + 0.45 * (z - 18.0)).max(0.2);
        let stack = planes(12, 3.0, |z| parting(n, spread, 2.2, z));
        let solid = cast(&stack);
        assert_sound(&solid, &stack);
        // n branches above one below.
        assert!(solid.lumen.slabs.len() + 1 >= n as usize, "{n}: {}", solid.lumen.slabs.len());
    }
}

#[test]
fn a_trifurcation_between_disks_of_one_size_is_built() {
    let stack =
        planes(6, 3.0, |z| if z < 8.0 { vec![disk(0.0, 0.0, 4.5)] } else { parting(3, |_| 3.2, 2.2, z) });
    assert_sound(&cast(&stack), &stack);
}

#[test]
fn events_with_one_plane_on_a_side_are_built() {
    let pair = || vec![disk(-2.6, 0.0, 2.0), disk(2.6, 0.2, 1.8)];
    let oval = || {
        let points = disk(0.0, 0.0, 1.0).points;
        vec![Contour::new(points.iter().map(|p| Point2::new(3.6 * p.x, 2.0 * p.y)).collect())]
    };
    for pattern in ["12", "122", "112", "1121", "11211", "112211", "1122211", "2112", "1221", "12121"] {
        let digits: Vec<char> = pattern.chars().collect();
        let stack = stack(
            digits
                .iter()
                .zip(0u32..)
                .map(|(d, k)| PlaneSections {
                    z_mm: 3.0 * f64::from(k),
                    contours: if *d == '1' { oval() } else { pair() },
                })
                .collect(),
        );
        let built = build(&stack, &Params::new(Body::Cast), &Task::quiet());
        let solid = built.unwrap_or_else(|e| panic!("{pattern}: {e}")).solid;
        assert_sound(&solid, &stack);
        let changes = digits.windows(2).filter(|d| d[0] != d[1]).count();
        assert_eq!(solid.lumen.slabs.len(), changes, "{pattern}");
    }
}

#[test]
fn a_branch_that_ends_inside_the_stack_gets_a_dome() {
    // A stump of radius 2 mm whose domes of 3 mm lie between the planes.
    for (start, end) in [(4.1, 19.9), (5.0, 19.0), (5.5, 18.5)] {
        let radius = |z: f64| {
            let depth = ((start + 3.0 - z) / 3.0).max((z - end + 3.0) / 3.0).max(0.0);
            2.0 * (1.0 - depth.powi(3)).max(0.0).sqrt()
        };
        let stack = planes(9, 3.0, |z| {
            let mut contours = vec![disk(0.0, 0.0, 3.0)];
            if radius(z) > 0.0 {
                contours.push(disk(8.0 + 0.1 * z, 0.0, radius(z)));
            }
            contours
        });
        let solid = cast(&stack);
        assert_sound(&solid, &stack);
        for k in 0..96 {
            let z = 0.25 * f64::from(k);
            let section = solid.section(z, 1e-3).outer;
            let stump = section.contours.iter().filter(|c| c.points.iter().all(|p| p.x > 4.0));
            let made = (stump.map(Contour::signed_area_mm2).sum::<f64>() / PI).sqrt();
            // Near the tip the surface is steep across: the radius there says little about the distance.
            if radius(z) > 1.2 {
                assert!((made - radius(z)).abs() < 0.15, "{start} {end} z {z}: {made} {}", radius(z));
            } else if z < start - 0.3 || z > end + 0.3 {
                assert!(made < 1e-9, "{start} {end} z {z}: {made}");
            }
        }
    }
}

#[test]
fn planes_at_irregular_distances_and_steep_branches_are_built() {
    let z = [0.0, 0.5, 6.5, 7.0, 11.0, 12.0, 18.0, 18.5, 19.5, 23.0, 29.0, 30.0];
    for slope in [0.3, 0.6] {
        let plane = |z_mm: f64| {
            let apart = (slope * (z_mm - 8.0)).max(0.0);
            let disks = [disk(0.0, 0.0, 3.0), disk(apart, 0.1 * z_mm, 1.6)].map(|c| Region::new(vec![c]));
            let joined = Region::union_all(&disks).contours;
            PlaneSections { z_mm, contours: joined.iter().map(|c| c.resampled(100 + c.len() % 60)).collect() }
        };
        let stack = stack(z.map(plane).to_vec());
        let solid = build(&stack, &Params::new(Body::Cast), &Task::quiet());
        let solid = solid.unwrap_or_else(|e| panic!("{slope}: {e}")).solid;
        assert_sound(&solid, &stack);
    }
}

#[test]
fn noise_on_the_contours_does_no_harm() {
    let vessel = Vessel::new(Kind::Carotid);
    for noise_mm in [0.02, 0.08] {
        let mut seed = 7u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            noise_mm * (f64::from(u32::try_from(seed >> 33).unwrap()) / f64::from(1u32 << 30) - 1.0)
        };
        let mut stack = planes(16, 3.0, |z| vessel.region_at(z + 45.0, 40).contours);
        for contour in stack.planes.iter_mut().flat_map(|p| &mut p.contours) {
            for p in &mut contour.points {
                *p += Vector2::new(noise(), noise());
            }
        }
        let solid = cast(&stack);
        for k in 0..180 {
            let z = 0.25 * f64::from(k);
            let (made, truth) = (solid.section(z, 1e-3).outer, vessel.region_at(z + 45.0, 256));
            let off = farthest(&made, &truth);
            assert!(off < 0.1 + 5.0 * noise_mm, "{noise_mm} z {z}: {off}");
        }
    }
}

/// A graph made by hand: nodes plane by plane, stars as (interval, lower, upper).
fn graph(step_mm: f64, nodes: &[(usize, Contour)], stars: &[(usize, &[usize], &[usize])]) -> Graph {
    let last = nodes.iter().map(|n| n.0).max().unwrap();
    Graph {
        z_mm: (0..=last).map(|k| step_mm * k as f64).collect(),
        given: (0..=last).map(Some).collect(),
        links: Vec::new(),
        nodes: nodes
            .iter()
            .map(|(plane, c)| Node { plane: *plane, contour: c.clone(), number: None })
            .collect(),
        stars: stars
            .iter()
            .map(|(interval, l, u)| Star { interval: *interval, lower: l.to_vec(), upper: u.to_vec() })
            .collect(),
        warnings: Vec::new(),
    }
}

fn skin_of(graph: &Graph) -> Solid {
    Solid { lumen: lumen::build(graph, Correspondence::default(), &Task::quiet()).unwrap().0, outer: None }
}

fn assert_area(solid: &Solid, z: f64, expected: f64, tolerance: f64) {
    let area = solid.section(z, 1e-4).outer.area_mm2();
    assert!((area - expected).abs() < tolerance, "z {z}: {area} {expected}");
}

fn assert_closed(solid: &Solid) {
    let how = Tessellation::within(0.05, SkinChoice::Lumen);
    let mesh = tessellate(solid, &how, &Task::quiet()).unwrap();
    assert!(closedness(&mesh).is_closed());
}

#[test]
fn a_hole_opens_and_closes_in_domes() {
    // Planes 0 to 6, a hole on planes 2 to 4.
    let mut nodes = Vec::new();
    for plane in 0..7 {
        nodes.push((plane, disk(0.0, 0.0, 5.0)));
        if (2..=4).contains(&plane) {
            nodes.push((plane, disk(0.5, 0.0, 1.5).reversed()));
        }
    }
    let outer = [0, 1, 2, 4, 6, 8, 9];
    let pairs: Vec<(usize, [usize; 1], [usize; 1])> = outer
        .windows(2)
        .enumerate()
        .map(|(k, o)| (k, [o[0]], [o[1]]))
        .chain([(2, [3], [5]), (3, [5], [7])])
        .collect();
    let stars: Vec<(usize, &[usize], &[usize])> =
        pairs.iter().map(|(k, l, u)| (*k, &l[..], &u[..])).collect();
    let solid = skin_of(&graph(2.0, &nodes, &stars));
    assert_area(&solid, 6.0, PI * (25.0 - 2.25), 0.01);
    assert_area(&solid, 2.0, PI * 25.0, 0.01);
    assert_eq!(solid.section(8.2, 1e-3).outer.contours.len(), 2);
    assert_closed(&solid);
}

#[test]
fn a_hole_parts_into_two() {
    let mut nodes = Vec::new();
    for plane in 0..6 {
        nodes.push((plane, disk(0.0, 0.0, 6.0)));
    }
    let oval =
        Contour::new(disk(0.0, 0.0, 1.0).points.iter().map(|p| Point2::new(2.9 * p.x, 1.5 * p.y)).collect());
    for plane in 0..3 {
        nodes.push((plane, oval.reversed()));
    }
    for plane in 3..6 {
        nodes.push((plane, disk(-1.9, 0.0, 1.3).reversed()));
        nodes.push((plane, disk(1.9, 0.0, 1.2).reversed()));
    }
    nodes.sort_by_key(|n| n.0);
    // 0 1 | 2 3 | 4 5 | 6 7 8 | 9 10 11 | 12 13 14
    let stars: [(usize, &[usize], &[usize]); 12] = [
        (0, &[0], &[2]),
        (0, &[1], &[3]),
        (1, &[2], &[4]),
        (1, &[3], &[5]),
        (2, &[4], &[6]),
        (2, &[5], &[7, 8]),
        (3, &[6], &[9]),
        (3, &[7], &[10]),
        (3, &[8], &[11]),
        (4, &[9], &[12]),
        (4, &[10], &[13]),
        (4, &[11], &[14]),
    ];
    let solid = skin_of(&graph(2.0, &nodes, &stars));
    assert_eq!((solid.lumen.tubes.len(), solid.lumen.slabs.len()), (4, 1));
    assert_eq!(solid.section(4.0, 1e-3).outer.contours.len(), 2);
    assert_eq!(solid.section(6.0, 1e-3).outer.contours.len(), 3);
    assert_closed(&solid);
}

/// A ring of mean radius 4 mm and half-width 1.2 mm that is open by an angle.
fn open_ring(half_gap_rad: f64) -> Contour {
    let polar = |r: f64, a: f64| Point2::new(r * a.cos(), r * a.sin());
    let (from, to) = (half_gap_rad, 2.0 * PI - half_gap_rad);
    let arc = |r: f64, a: f64, b: f64| (0..=80).map(move |i| polar(r, a + (b - a) * f64::from(i) / 80.0));
    let cap = |a: f64, turn: f64| {
        let centre = polar(4.0, a);
        (1..20).map(move |i| {
            let t = turn + PI * f64::from(i) / 20.0;
            centre + 1.2 * Vector2::new(t.cos(), t.sin())
        })
    };
    Contour::new(
        arc(5.2, from, to).chain(cap(to, to)).chain(arc(2.8, to, from)).chain(cap(from, from + PI)).collect(),
    )
}

#[test]
fn an_outline_closes_round_a_hole_and_opens_again() {
    // Open rings on planes 0 to 2 and 6 to 8, closed ones on 3 to 5.
    let mut nodes = Vec::new();
    for plane in 0..9 {
        if (3..6).contains(&plane) {
            nodes.push((plane, disk(0.0, 0.0, 5.2)));
            nodes.push((plane, disk(0.0, 0.0, 2.8).reversed()));
        } else {
            nodes.push((plane, open_ring(0.6)));
        }
    }
    // 0 | 1 | 2 | 3 4 | 5 6 | 7 8 | 9 | 10 | 11
    let stars: [(usize, &[usize], &[usize]); 10] = [
        (0, &[0], &[1]),
        (1, &[1], &[2]),
        (2, &[2], &[3, 4]),
        (3, &[3], &[5]),
        (3, &[4], &[6]),
        (4, &[5], &[7]),
        (4, &[6], &[8]),
        (5, &[7, 8], &[9]),
        (6, &[9], &[10]),
        (7, &[10], &[11]),
    ];
    let solid = skin_of(&graph(2.0, &nodes, &stars));
    assert_eq!(solid.lumen.slabs.len(), 2);
    let ring = PI * (5.2f64.powi(2) - 2.8f64.powi(2));
    assert_area(&solid, 8.0, ring, 0.1);
    // The spline encloses a little more than its polygon.
    assert_area(&solid, 4.0, open_ring(0.6).signed_area_mm2(), 0.1);
    assert_closed(&solid);
    // Between the planes the area goes over without a jump.
    let areas: Vec<f64> =
        (0..=80).map(|k| solid.section(4.0 + 0.025 * f64::from(k), 1e-3).outer.area_mm2()).collect();
    assert!(areas.windows(2).all(|a| (a[1] - a[0]).abs() < 1.0), "{areas:?}");
}

/// Centre and radius of a disk at a height.
type Path = Box<dyn Fn(f64) -> (Point2, f64)>;

/// Disks on paths, joined by the quadratic smooth minimum of radius 0.8 mm.
struct Disks {
    paths: Vec<Path>,
}

impl Disks {
    fn value(&self, p: Point2, z: f64) -> f64 {
        let far = self.paths.iter().map(|path| path(z)).map(|(c, r)| (p - c).norm() - r);
        far.reduce(|a, b| a.min(b) - (0.8 - (a - b).abs()).max(0.0).powi(2) / 3.2).unwrap_or(1.0)
    }

    fn stack(&self, n: u32, step_mm: f64) -> SectionStack {
        planes(n, step_mm, |z| {
            let jet = |p: Point2| {
                const H: f64 = 1e-5;
                let along = |d: Vector2| (self.value(p + d, z) - self.value(p - d, z)) / (2.0 * H);
                let slope = Vector2::new(along(Vector2::new(H, 0.0)), along(Vector2::new(0.0, H)));
                Jet { value: self.value(p, z), slope }
            };
            let bounds = Bounds2::of([Point2::new(-15.0, -15.0), Point2::new(15.0, 15.0)]).unwrap();
            iso::contours(&jet, bounds, 0.15).iter().map(|c| c.resampled(128)).collect()
        })
    }

    /// Farthest that a solid's sections at these heights lie from the disks'.
    fn farthest(&self, solid: &Solid, heights: impl Iterator<Item = f64>) -> f64 {
        let at = |z: f64| {
            let section = solid.section(z, 1e-3).outer;
            let points = section.contours.iter().flat_map(|c| c.points.iter());
            points.map(|&p| self.value(p, z).abs()).fold(0.0, f64::max)
        };
        heights.map(at).fold(0.0, f64::max)
    }
}

#[test]
fn branches_that_part_in_one_interval_after_the_other_are_where_they_all_lead() {
    let path = |k: u32| -> Path {
        let (sin, cos) = (0.2 + 2.0 * PI * f64::from(k) / 3.0).sin_cos();
        Box::new(move |z| {
            let from = z - 14.0 - 2.2 * f64::from(k);
            let spread = 9.0 * (1.0 - (-0.5 * (from + (from * from + 16.0).sqrt()) / 14.0).exp());
            (Point2::new(spread * cos, spread * sin), 2.2)
        })
    };
    let disks = Disks { paths: (0..3).map(path).collect() };
    let stack = disks.stack(12, 3.0);
    let counts: Vec<usize> = stack.planes.iter().map(|p| p.contours.len()).collect();
    assert!(counts.windows(3).any(|c| c == [1, 2, 3]), "{counts:?}");
    let solid = cast(&stack);
    assert_sound(&solid, &stack);
    let off = disks.farthest(&solid, (30..110).map(|k| 0.25 * f64::from(k)));
    assert!(off < 0.15, "{off}");
}

#[test]
fn branches_seen_apart_on_one_plane_only_are_told_by_the_planes_on_both_sides() {
    let path = |side: f64, radius: f64| -> Path {
        Box::new(move |z| (Point2::new(side * 2.6 * (-((z - 15.0) / 5.0).powi(2)).exp(), 0.0), radius))
    };
    let disks = Disks { paths: vec![path(1.0, 2.1), path(-1.0, 2.3)] };
    let stack = disks.stack(11, 3.0);
    let apart = stack.planes.iter().filter(|p| p.contours.len() == 2).count();
    assert_eq!(apart, 1);
    let solid = cast(&stack);
    assert_sound(&solid, &stack);
    let off = disks.farthest(&solid, (20..100).map(|k| 0.3 * f64::from(k)));
    assert!(off < 0.12, "{off}");
}

#[test]
fn a_crotch_a_hair_from_a_plane_is_built() {
    for hair_mm in [0.1, 0.05] {
        let apex = 18.0 - hair_mm;
        // The blend lowers the field in the middle by a fifth of a millimetre: there it is zero at the apex.
        let path = |side: f64| -> Path {
            Box::new(move |z| {
                let apart = 1.4 + 0.25 * (z - apex + (z - apex).hypot(4.0));
                (Point2::new(side * apart, 0.05 * z), 2.2)
            })
        };
        let disks = Disks { paths: vec![path(1.0), path(-1.0)] };
        let stack = disks.stack(12, 3.0);
        let solid = cast(&stack);
        assert_sound(&solid, &stack);
        let found = brep::check(&brep::Brep::of(&solid, SkinChoice::Lumen));
        assert!(found.is_ok(), "{hair_mm}: {found:?}");
    }
}
