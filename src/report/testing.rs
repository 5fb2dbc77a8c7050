//! Synthetic cases with closed forms, for the tests of this room.

use super::image::Polarity;
use super::record::{Record, Segment};
use super::{About, BodyKind, Image, Inputs, Job, Triangles};
use crate::ct::{Volume, Voxels};
use crate::geom::{Contour, Point2, Point3, Region, RigidTransform, Vector2, Vector3};
use crate::sections::{PlaneSections, SectionStack};
use crate::slice::{Layer, LayerSlot};
use crate::solid::{CrossSection, Sectioned};
use crate::toolpath::{Bead, BeadKind, BeadPoint, Compensation, LayerPaths, Toolpaths};

/// Blur of the synthetic images, mm.
const BLUR_MM: f64 = 0.35;
/// Distance of the synthetic planes, mm.
pub(super) const INTERVAL_MM: f64 = 3.0;
/// Height of the synthetic layers, mm.
pub(super) const LAYER_MM: f64 = 0.2;
/// Radius of the synthetic lumen, mm.
pub(super) const RADIUS_MM: f64 = 3.0;
/// Thickness of the synthetic wall, mm.
pub(super) const WALL_MM: f64 = 1.2;
/// Width of the synthetic beads, mm: three fill the wall.
pub(super) const BEAD_MM: f64 = 0.4;

/// The normal distribution function, by Abramowitz and Stegun 7.1.26 (1.5e-7).
fn normal_distribution(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x.abs() / 2f64.sqrt());
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * poly * (-0.5 * x * x).exp();
    if x > 0.0 { 1.0 - tail } else { tail }
}

/// A disk of value 1 after a Gaussian blur, at the distance `r` from its centre: integrated over chords.
fn blurred_disk(r: f64, radius_mm: f64) -> f64 {
    let n = 161;
    let step = 8.0 / f64::from(n - 1);
    let chord = |i: i32| {
        let u = step * f64::from(i) - 4.0;
        let half2 = radius_mm * radius_mm - (r + BLUR_MM * u).powi(2);
        let inside = 2.0 * normal_distribution(half2.max(0.0).sqrt() / BLUR_MM) - 1.0;
        inside * (-0.5 * u * u).exp() * step / std::f64::consts::TAU.sqrt()
    };
    (0..n).map(chord).sum()
}

/// A vertical cylinder, blurred as a scanner blurs.
pub(super) fn blurred_cylinder(polarity: Polarity, radius_mm: f64, n_planes: usize, noise_hu: f64) -> Volume {
    let (inner, outer) = if polarity == Polarity::Bright { (300.0, 50.0) } else { (-20.0, 120.0) };
    blurred_shells(&[(radius_mm, inner)], outer, n_planes, noise_hu)
}

/// Vertical cylinders in one another, from the inside out, each with its radius in mm and its grey value; blurred.
pub(super) fn blurred_shells(shells: &[(f64, f64)], outer_hu: f64, n_planes: usize, noise_hu: f64) -> Volume {
    let (n, pixel_mm) = (100usize, 0.2);
    let first = -0.5 * pixel_mm * (n - 1) as f64;
    let mut noise = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = || {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (noise >> 33) as f64 / f64::from(1u32 << 31) - 0.5
    };
    let beyond = |i: usize| shells.get(i + 1).map_or(outer_hu, |shell| shell.1);
    let at_radius = |r: f64| -> f64 {
        let steps = shells.iter().enumerate();
        outer_hu + steps.map(|(i, s)| (s.1 - beyond(i)) * blurred_disk(r, s.0)).sum::<f64>()
    };
    let table: Vec<f64> = (0..1500).map(|i| at_radius(0.01 * f64::from(i))).collect();
    let mut value = |i: usize, j: usize| {
        let r = 100.0 * (first + pixel_mm * i as f64).hypot(first + pixel_mm * j as f64);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the image")]
        let (below, part) = (r as usize, r.fract());
        // Uniform noise of the same standard deviation.
        table[below] * (1.0 - part) + table[below + 1] * part + noise_hu * 12f64.sqrt() * random()
    };
    #[expect(clippy::cast_possible_truncation, reason = "grey values fit")]
    let hu: Vec<f32> = (0..n_planes * n * n).map(|v| value(v % n, v / n % n) as f32).collect();
    Volume {
        dims: [n, n, n_planes],
        hu: Voxels::new(&hu, n * n),
        origin_xy_mm: [first; 2],
        pixel_spacing_xy_mm: [pixel_mm; 2],
        plane_z_mm: (0..n_planes).map(|k| INTERVAL_MM * k as f64).collect(),
        slab_thickness_mm: 2.0,
        patient_from_stack: RigidTransform::identity(),
    }
}

/// A hollow tube, straight up.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tube {
    pub(super) radius_mm: f64,
    pub(super) z_mm: [f64; 2],
}

pub(super) fn disk(radius_mm: f64) -> Region {
    Region::new(vec![Contour::circle(Point2::origin(), radius_mm, 360)])
}

impl Sectioned for Tube {
    fn z_range_mm(&self) -> [f64; 2] {
        self.z_mm
    }

    fn section(&self, z_mm: f64, _tolerance_mm: f64) -> CrossSection {
        if z_mm < self.z_mm[0] || z_mm > self.z_mm[1] {
            return CrossSection::default();
        }
        CrossSection { outer: disk(self.radius_mm + WALL_MM), lumen: disk(self.radius_mm) }
    }
}

/// A whole case, all stages perfect until a test spoils one.
#[derive(Debug)]
pub(super) struct Made<S> {
    pub(super) volume: Volume,
    pub(super) sections: SectionStack,
    pub(super) solid: S,
    pub(super) layers: Vec<Layer>,
    pub(super) paths: Toolpaths,
    pub(super) record: Record,
}

/// A case of a straight tube.
pub(super) type Case = Made<Tube>;
/// A case of a vessel of circles.
pub(super) type Forked = Made<Shape>;

/// A case as the report takes it.
pub(super) fn inputs<S: Sectioned>(case: &Made<S>) -> Inputs<'_> {
    Inputs {
        image: Some(Image { volume: &case.volume, polarity: Polarity::Bright }),
        sections: &case.sections,
        solid: &case.solid,
        body: BodyKind::Wall,
        layers: &case.layers,
        paths: &case.paths,
        record: &case.record,
        job_beads: None,
        scan: None,
        warnings: &[],
        job: Job::default(),
        triangles: &[
            Triangles { deflection_mm: 0.1, n_triangles: 800 },
            Triangles { deflection_mm: 0.01, n_triangles: 8000 },
        ],
        gate: crate::profile::gate::builtin("marlin").unwrap(),
        about: &About::UNKNOWN,
    }
}

impl Case {
    pub(super) fn new(n_planes: usize) -> Self {
        let half = 0.5 * INTERVAL_MM;
        let top = INTERVAL_MM * (n_planes - 1) as f64 + half;
        let layers: Vec<Layer> = slots(n_planes).into_iter().map(layer).collect();
        let bed_from_stack = RigidTransform::translation(Vector3::new(100.0, 90.0, half));
        let paths = Toolpaths {
            bed_from_stack,
            compensation: Compensation::default(),
            layers: layers.iter().map(|l| plan(l, &bed_from_stack)).collect(),
        };
        Self {
            volume: blurred_cylinder(Polarity::Bright, RADIUS_MM, n_planes, 0.0),
            sections: SectionStack {
                planes: (0..n_planes)
                    .map(|k| PlaneSections {
                        z_mm: INTERVAL_MM * k as f64,
                        contours: vec![Contour::circle(Point2::origin(), RADIUS_MM, 128)],
                    })
                    .collect(),
                patient_from_stack: RigidTransform::identity(),
            },
            solid: Tube { radius_mm: RADIUS_MM, z_mm: [-half, top] },
            record: print(&paths),
            layers,
            paths,
        }
    }
}

/// Layers of 0.2 mm, one centred on each plane.
fn slots(n_planes: usize) -> Vec<LayerSlot> {
    let per_interval = 15;
    (0..n_planes * per_interval)
        .map(|i| LayerSlot {
            z_mid_mm: LAYER_MM * (i as f64 - 7.0),
            height_mm: LAYER_MM,
            ct_plane: (i % per_interval == 7).then_some(i / per_interval),
        })
        .collect()
}

fn layer(slot: LayerSlot) -> Layer {
    let lumen = disk(RADIUS_MM);
    Layer { slot, material: disk(RADIUS_MM + WALL_MM).difference(&lumen), lumen }
}

fn plan(layer: &Layer, bed_from_stack: &RigidTransform) -> LayerPaths {
    let on_bed = |p: Point2| bed_from_stack.apply(Point3::new(p.x, p.y, 0.0)).xy();
    let bead = |i: u32| {
        let circle = Contour::circle(Point2::origin(), RADIUS_MM + BEAD_MM * (0.5 + f64::from(i)), 120);
        let mut points: Vec<BeadPoint> =
            circle.points.iter().map(|&p| BeadPoint { at: on_bed(p), width_mm: BEAD_MM }).collect();
        points.push(points[0]);
        Bead { kind: BeadKind::ExternalPerimeter, points }
    };
    let moved = |r: &Region| {
        let contour = |c: &Contour| Contour::new(c.points.iter().map(|&p| on_bed(p)).collect());
        Region::new(r.contours.iter().map(contour).collect())
    };
    let bottom = bed_from_stack.apply(Point3::new(0.0, 0.0, layer.slot.z_mid_mm)).z;
    LayerPaths {
        slot: layer.slot,
        z_mm: bottom + 0.5 * layer.slot.height_mm,
        beads: (0..3).map(bead).collect(),
        travels: Vec::new(),
        material: moved(&layer.material),
        lumen: moved(&layer.lumen),
    }
}

/// Lumina that are circles: centre and radius, mm.
pub(super) type Circles = Vec<(Point2, f64)>;

/// A vessel that winds and divides at half its height into two branches: no plane is like another, none like its
/// mirror image.
pub(super) fn fork(z_mm: f64, n_planes: usize) -> Circles {
    let part = z_mm / (INTERVAL_MM * (n_planes - 1) as f64);
    let bend = Point2::new(2.2 * (2.3 * part).sin() - 0.8, 2.6 * part * part - 1.0);
    if part < 0.5 {
        return vec![(bend, 2.6 + 0.8 * part)];
    }
    let apart = 2.4 + 1.6 * (part - 0.5);
    vec![(bend - Vector2::new(apart, 0.4), 1.7), (bend + Vector2::new(apart, 0.0), 1.5 - 0.4 * (part - 0.5))]
}

pub(super) fn region_of(circles: &Circles, wider_mm: f64) -> Region {
    let disks: Vec<Region> =
        circles.iter().map(|(c, r)| Region::new(vec![Contour::circle(*c, r + wider_mm, 240)])).collect();
    Region::union_all(&disks)
}

/// A solid whose lumen is given by height.
pub(super) struct Shape {
    pub(super) z_mm: [f64; 2],
    pub(super) lumen: Box<dyn Fn(f64) -> Region + Sync>,
}

impl std::fmt::Debug for Shape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shape").field("z_mm", &self.z_mm).finish_non_exhaustive()
    }
}

impl Sectioned for Shape {
    fn z_range_mm(&self) -> [f64; 2] {
        self.z_mm
    }

    fn section(&self, z_mm: f64, _tolerance_mm: f64) -> CrossSection {
        let lumen = (self.lumen)(z_mm);
        CrossSection { outer: lumen.offset(WALL_MM, 1e-3).union(&lumen), lumen }
    }
}

/// A vessel whose axis lies in a plane, and that divides: it is its own mirror image.
pub(super) fn flat_fork(z_mm: f64, n_planes: usize) -> Circles {
    let part = z_mm / (INTERVAL_MM * (n_planes - 1) as f64);
    if part < 0.5 {
        return vec![(Point2::new(0.4 - 0.8 * part, 0.0), 2.6 + 0.4 * part)];
    }
    let apart = 2.4 + 1.6 * (part - 0.5);
    vec![(Point2::new(-apart, 0.0), 1.9), (Point2::new(apart, 0.0), 1.5)]
}

impl Forked {
    pub(super) fn new(n_planes: usize) -> Self {
        Self::of(n_planes, fork)
    }

    /// The vessel with these lumina, by height and number of planes.
    pub(super) fn of(n_planes: usize, lumina: fn(f64, usize) -> Circles) -> Self {
        let half = 0.5 * INTERVAL_MM;
        let circles = |z_mm: f64| lumina(z_mm, n_planes);
        let bed_from_stack = RigidTransform::translation(Vector3::new(100.0, 90.0, half));
        let (mut layers, mut paths) = (Vec::new(), Vec::new());
        for slot in slots(n_planes) {
            let circles = circles(slot.z_mid_mm);
            let lumen = region_of(&circles, 0.0);
            let layer = Layer { slot, material: region_of(&circles, WALL_MM).difference(&lumen), lumen };
            paths.push(plan_rings(&layer, &circles, &bed_from_stack));
            layers.push(layer);
        }
        let paths = Toolpaths { bed_from_stack, compensation: Compensation::default(), layers: paths };
        let plane = |k: usize| {
            let z_mm = INTERVAL_MM * k as f64;
            let contours = circles(z_mm).iter().map(|(c, r)| Contour::circle(*c, *r, 128)).collect();
            PlaneSections { z_mm, contours }
        };
        Self {
            volume: blurred_circles(
                &(0..n_planes).map(|k| circles(INTERVAL_MM * k as f64)).collect::<Vec<_>>(),
            ),
            sections: SectionStack {
                planes: (0..n_planes).map(plane).collect(),
                patient_from_stack: RigidTransform::identity(),
            },
            solid: Shape {
                z_mm: [-half, INTERVAL_MM * (n_planes - 1) as f64 + half],
                lumen: Box::new(move |z_mm| region_of(&lumina(z_mm, n_planes), 0.0)),
            },
            record: print(&paths),
            layers,
            paths,
        }
    }
}

/// Rings around every lumen.
fn plan_rings(layer: &Layer, circles: &Circles, bed_from_stack: &RigidTransform) -> LayerPaths {
    let on_bed = |p: Point2| bed_from_stack.apply(Point3::new(p.x, p.y, 0.0)).xy();
    let bead = |(centre, radius_mm): (Point2, f64), i: u32| {
        let circle = Contour::circle(centre, radius_mm + BEAD_MM * (0.5 + f64::from(i)), 72);
        let mut points: Vec<BeadPoint> =
            circle.points.iter().map(|&p| BeadPoint { at: on_bed(p), width_mm: BEAD_MM }).collect();
        points.push(points[0]);
        let kind = if i == 1 { BeadKind::Perimeter } else { BeadKind::ExternalPerimeter };
        Bead { kind, points }
    };
    let rings = |circle: &(Point2, f64)| (0..3).map(|i| bead(*circle, i)).collect::<Vec<_>>();
    LayerPaths { beads: circles.iter().flat_map(rings).collect(), ..plan(layer, bed_from_stack) }
}

/// Bright circles in a dark surrounding, blurred, plane by plane.
fn blurred_circles(planes: &[Circles]) -> Volume {
    let (n, pixel_mm) = (100usize, 0.2);
    let first = -0.5 * pixel_mm * (n - 1) as f64;
    let mut hu = Vec::with_capacity(planes.len() * n * n);
    for circles in planes {
        let tables: Vec<Vec<f64>> = circles
            .iter()
            .map(|(_, r)| (0..300).map(|i| blurred_disk(0.1 * f64::from(i), *r)).collect())
            .collect();
        for v in 0..n * n {
            let at = Point2::new(first + pixel_mm * (v % n) as f64, first + pixel_mm * (v / n) as f64);
            let shares = circles.iter().zip(&tables).map(|((c, _), table)| {
                let place = 10.0 * (at - c).norm();
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "within the image"
                )]
                let below = place as usize;
                table[below] * (1.0 - place.fract()) + table[below + 1] * place.fract()
            });
            #[expect(clippy::cast_possible_truncation, reason = "grey values fit")]
            hu.push((50.0 + 250.0 * shares.sum::<f64>()) as f32);
        }
    }
    Volume {
        dims: [n, n, planes.len()],
        hu: Voxels::new(&hu, n * n),
        origin_xy_mm: [first; 2],
        pixel_spacing_xy_mm: [pixel_mm; 2],
        plane_z_mm: (0..planes.len()).map(|k| INTERVAL_MM * k as f64).collect(),
        slab_thickness_mm: 2.0,
        patient_from_stack: RigidTransform::identity(),
    }
}

/// What a perfect printer records.
pub(super) fn print(paths: &Toolpaths) -> Record {
    let segments = paths.layers.iter().flat_map(|layer| {
        layer.beads.iter().flat_map(move |bead| {
            bead.points.windows(2).map(move |pair| {
                let at = |p: Point2| Point3::new(p.x, p.y, layer.z_mm);
                let height_mm = layer.slot.height_mm;
                let width_mm = pair[0].width_mm;
                let volume_mm3 = (pair[1].at - pair[0].at).norm() * width_mm * height_mm;
                Segment { from: at(pair[0].at), to: at(pair[1].at), volume_mm3, width_mm, height_mm }
            })
        })
    });
    Record { segments: segments.collect(), ..Record::default() }
}
