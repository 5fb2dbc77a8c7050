//! Region growing, from a seed and by itself, and contour extraction on 46 planes of 512 x 512, over the noise.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use lumenfab::ct::{Volume, Voxels};
use lumenfab::geom::{Point3, RigidTransform};
use lumenfab::progress::Task;
use lumenfab::{sections, segment};
use std::hint::black_box;

const N: usize = 512;
const N_PLANES: usize = 46;
const PIXEL_MM: f64 = 0.2;

/// Two vessels that part in the middle of the stack, with a deterministic grain.
fn volume(noise_hu: f64) -> Volume {
    let mut state = 1_u64;
    let mut grain = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let mut hu: Vec<f32> = Vec::with_capacity(N * N * N_PLANES);
    for k in 0..N_PLANES {
        let apart = 0.25 * (k as f64 - 20.0).max(0.0);
        for p in 0..N * N {
            let (x, y) = ((p % N) as f64 * PIXEL_MM - 51.0, (p / N) as f64 * PIXEL_MM - 51.0);
            let edge = ((x - apart).hypot(y) - 2.6).min((x + apart).hypot(y) - 2.9);
            // A logistic edge as steep as one blurred by 0.35 mm.
            let lumen = 1.0 / (1.0 + (edge / 0.2).exp());
            #[expect(clippy::cast_possible_truncation, reason = "intensities are single precision")]
            hu.push((60.0 + 240.0 * lumen + 3.46 * noise_hu * grain()) as f32);
        }
    }
    Volume {
        dims: [N, N, N_PLANES],
        hu: Voxels::new(&hu, N * N),
        origin_xy_mm: [-51.0, -51.0],
        pixel_spacing_xy_mm: [PIXEL_MM, PIXEL_MM],
        plane_z_mm: (0..N_PLANES).map(|k| 3.0 * k as f64).collect(),
        slab_thickness_mm: 2.0,
        patient_from_stack: RigidTransform::identity(),
    }
}

fn segment(c: &mut Criterion) {
    let mut group = c.benchmark_group("segment");
    group.sample_size(20);
    let params = segment::Params { seeds_patient_mm: vec![Point3::origin()], ..Default::default() };
    for noise_hu in [0.0, 25.0] {
        let volume = volume(noise_hu);
        group.bench_with_input(BenchmarkId::new("grow", noise_hu), &volume, |b, volume| {
            b.iter(|| segment::segment(black_box(volume), &params, &Task::quiet()).expect("a lumen"));
        });
        let by_itself = segment::Params::default();
        group.bench_with_input(BenchmarkId::new("unattended", noise_hu), &volume, |b, volume| {
            b.iter(|| {
                segment::find_unattended(black_box(volume), &by_itself, &Task::quiet()).expect("a vessel")
            });
        });
        let mask = segment::segment(&volume, &params, &Task::quiet()).expect("a lumen");
        group.bench_with_input(BenchmarkId::new("extract", noise_hu), &volume, |b, volume| {
            let params = sections::Params::default();
            b.iter(|| {
                sections::extract(black_box(volume), &mask, &params, &Task::quiet()).expect("contours")
            });
        });
    }
    group.finish();
}

criterion_group!(benches, segment);
criterion_main!(benches);
