//! The report of a vessel that divides: 46 planes, 690 layers, about 270 000 recorded segments.

use criterion::{Criterion, criterion_group, criterion_main};
use lumenfab::ct::{Volume, Voxels};
use lumenfab::geom::{Contour, Point2, Point3, Region, RigidTransform, SegmentIndex, Vector3};
use lumenfab::progress::Task;
use lumenfab::report::{self, BodyKind, Image, Inputs, Polarity, Record};
use lumenfab::sections::{PlaneSections, SectionStack};
use lumenfab::slice::{Layer, LayerSlot};
use lumenfab::solid::{CrossSection, Sectioned};
use lumenfab::toolpath::{Bead, BeadKind, BeadPoint, Compensation, LayerPaths, Toolpaths};
use std::hint::black_box;

const N_PLANES: usize = 46;
const LAYERS_PER_PLANE: usize = 15;
const LAYER_MM: f64 = 0.2;
const WALL_MM: f64 = 1.2;
const BEAD_MM: f64 = 0.4;

/// A trunk that divides at a third of its height.
struct Vessel;

impl Vessel {
    fn lumen(z_mm: f64) -> Region {
        let apart = (0.12 * (z_mm - 40.0)).clamp(0.0, 6.5);
        let disk = |x: f64, r: f64| {
            Region::new(vec![Contour::circle(Point2::new(x + 0.02 * z_mm, 0.05 * z_mm), r, 128)])
        };
        disk(-apart, 3.4 - 0.06 * apart).union(&disk(apart, 3.0 - 0.05 * apart))
    }
}

impl Sectioned for Vessel {
    fn z_range_mm(&self) -> [f64; 2] {
        [-1.5, 3.0 * (N_PLANES - 1) as f64 + 1.5]
    }

    fn section(&self, z_mm: f64, tolerance_mm: f64) -> CrossSection {
        let lumen = Self::lumen(z_mm);
        CrossSection { outer: lumen.offset(WALL_MM, tolerance_mm), lumen }
    }
}

struct Case {
    volume: Volume,
    sections: SectionStack,
    layers: Vec<Layer>,
    paths: Toolpaths,
    record: Record,
}

impl Case {
    fn new() -> Self {
        let sections = SectionStack {
            planes: (0..N_PLANES)
                .map(|k| PlaneSections {
                    z_mm: 3.0 * k as f64,
                    contours: Vessel::lumen(3.0 * k as f64).contours,
                })
                .collect(),
            patient_from_stack: RigidTransform::identity(),
        };
        let layers: Vec<Layer> = (0..N_PLANES * LAYERS_PER_PLANE).map(layer).collect();
        let bed_from_stack = RigidTransform::translation(Vector3::new(100.0, 100.0, 1.5));
        let paths = Toolpaths {
            bed_from_stack,
            compensation: Compensation::default(),
            layers: layers.iter().map(|l| plan(l, &bed_from_stack)).collect(),
        };
        let record = report::record::parse(&beads_csv(&paths)).expect("the text was made here");
        Self { volume: image(&sections), sections, layers, paths, record }
    }

    fn inputs(&self) -> Inputs<'_> {
        Inputs {
            scan: None,
            image: Some(Image { volume: &self.volume, polarity: Polarity::Dark }),
            sections: &self.sections,
            solid: &Vessel,
            body: BodyKind::Wall,
            layers: &self.layers,
            paths: &self.paths,
            record: &self.record,
            job_beads: None,
            warnings: &[],
            job: report::Job::default(),
            triangles: &[],
            about: &report::About::UNKNOWN,
            gate: lumenfab::profile::gate::builtin("marlin").expect("it is built in"),
        }
    }
}

fn layer(i: usize) -> Layer {
    let slot = LayerSlot {
        z_mid_mm: LAYER_MM * (i as f64 - 7.0),
        height_mm: LAYER_MM,
        ct_plane: (i % LAYERS_PER_PLANE == 7).then_some(i / LAYERS_PER_PLANE),
    };
    let CrossSection { outer, lumen } = Vessel.section(slot.z_mid_mm, 1e-3);
    Layer { slot, material: outer.difference(&lumen), lumen }
}

fn plan(layer: &Layer, bed_from_stack: &RigidTransform) -> LayerPaths {
    let on_bed = |p: &Point2| bed_from_stack.apply(Point3::new(p.x, p.y, 0.0)).xy();
    let bead = |contour: &Contour| {
        let mut points: Vec<BeadPoint> =
            contour.points.iter().map(|p| BeadPoint { at: on_bed(p), width_mm: BEAD_MM }).collect();
        points.extend(points.first().copied());
        Bead { kind: BeadKind::ExternalPerimeter, points }
    };
    let moved = |r: &Region| {
        Region::new(r.contours.iter().map(|c| Contour::new(c.points.iter().map(on_bed).collect())).collect())
    };
    let loops = (0..3).flat_map(|i| layer.lumen.offset(BEAD_MM * (0.5 + f64::from(i)), 1e-2).contours);
    let loops = loops.map(|c| c.resampled(128));
    let top = layer.slot.z_mid_mm + 0.5 * LAYER_MM;
    LayerPaths {
        slot: layer.slot,
        z_mm: bed_from_stack.apply(Point3::new(0.0, 0.0, top)).z,
        beads: loops.map(|c| bead(&c)).collect(),
        travels: Vec::new(),
        material: moved(&layer.material),
        lumen: moved(&layer.lumen),
    }
}

/// What a printer records that is off by a few hundredths here and there.
fn beads_csv(paths: &Toolpaths) -> String {
    use std::fmt::Write;
    let mut text =
        String::from("t_s,x0_mm,y0_mm,z0_mm,x1_mm,y1_mm,z1_mm,volume_mm3,width_mm,height_mm,hotend_c\n");
    for (i, layer) in paths.layers.iter().enumerate() {
        let off = 0.03 * (0.1 * i as f64).sin();
        for pair in layer.beads.iter().flat_map(|b| b.points.windows(2)) {
            let (a, b, z, width) = (pair[0].at, pair[1].at, layer.z_mm, pair[0].width_mm - 0.5 * off.abs());
            let volume = (b - a).norm() * width * LAYER_MM;
            let (x0, x1) = (a.x + off, b.x + off);
            writeln!(
                text,
                "0.0,{x0:.4},{:.4},{z:.4},{x1:.4},{:.4},{z:.4},{volume:.5},{width:.4},{LAYER_MM},210.0",
                a.y, b.y
            )
            .expect("a String takes all");
        }
    }
    text
}

/// A dark lumen in a bright wall in grey tissue, blurred and noisy.
fn image(sections: &SectionStack) -> Volume {
    let (n, pixel_mm, first) = (240_usize, 0.2, -22.0);
    let mut hu = vec![0f32; n * n * N_PLANES];
    let mut noise = 7_u64;
    for (k, plane) in sections.planes.iter().enumerate() {
        let index = SegmentIndex::try_new(&plane.contours).expect("the vessel is everywhere");
        for (v, value) in hu[k * n * n..(k + 1) * n * n].iter_mut().enumerate() {
            let p = Point2::new(first + pixel_mm * (v % n) as f64, first + pixel_mm * (v / n) as f64);
            let d = index.signed_distance_mm(p);
            let step = |at: f64| 0.5 + 0.5 * ((d - at) / 0.35).tanh();
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let random = (noise >> 33) as f64 / f64::from(1_u32 << 31) - 0.5;
            let hu = -50.0 + 200.0 * step(0.0) - 110.0 * step(1.4) + 30.0 * random;
            #[expect(clippy::cast_possible_truncation, reason = "a grey value")]
            let hu = hu as f32;
            *value = hu;
        }
    }
    Volume {
        dims: [n, n, N_PLANES],
        hu: Voxels::new(&hu, n * n),
        origin_xy_mm: [first; 2],
        pixel_spacing_xy_mm: [pixel_mm; 2],
        plane_z_mm: sections.plane_z_mm(),
        slab_thickness_mm: 2.0,
        patient_from_stack: RigidTransform::identity(),
    }
}

fn bench(c: &mut Criterion) {
    let case = Case::new();
    let csv = beads_csv(&case.paths);
    let mut group = c.benchmark_group("report");
    group.sample_size(10);
    group.bench_function("parse the record", |b| b.iter(|| report::record::parse(black_box(&csv))));
    group.bench_function("build 46 planes, 690 layers", |b| {
        b.iter(|| report::build(black_box(&case.inputs()), &Task::quiet()));
    });
    let built = report::build(&case.inputs(), &Task::quiet()).expect("the case is whole");
    group.bench_function("page", |b| b.iter(|| report::html(black_box(&built))));
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
