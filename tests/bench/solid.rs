//! Sections to solid, solid to triangles: the reference phantom's contours, lumen alone and with its wall.

use criterion::{Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use lumenfab::brep::{Brep, check};
use lumenfab::geom::RigidTransform;
use lumenfab::mesh::{Deflection, SkinChoice, Tessellation, tessellate};
use lumenfab::phantom::{Kind, Vessel};
use lumenfab::progress::Task;
use lumenfab::sections::{PlaneSections, SectionStack};
use lumenfab::solid::{Body, Params, build};
use std::hint::black_box;

/// 46 planes 3 mm apart, 128 points a contour.
fn stack() -> SectionStack {
    let vessel = Vessel::new(Kind::Carotid);
    let plane = |k: u32| {
        let z_mm = 3.0 * f64::from(k);
        PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
    };
    SectionStack { planes: (0..46).map(plane).collect(), patient_from_stack: RigidTransform::identity() }
}

/// The reference phantom ten and a hundred times as finely cut.
fn finer_stacks() -> [(u32, SectionStack); 3] {
    let vessel = Vessel::new(Kind::Carotid);
    [46, 460, 4600].map(|n_planes: u32| {
        let plane = |k: u32| {
            let z_mm = 135.0 * f64::from(k) / f64::from(n_planes - 1);
            PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
        };
        let planes = (0..n_planes).map(plane).collect();
        (n_planes, SectionStack { planes, patient_from_stack: RigidTransform::identity() })
    })
}

/// The reference phantom several times one above the other, every second one upside down: as many more splits and merges.
fn longer_stack(n_copies: u32) -> SectionStack {
    let vessel = Vessel::new(Kind::Carotid);
    let plane = |k: u32| {
        let (copy, rest) = (k / 46, k % 46);
        let of_vessel = if copy % 2 == 0 { rest } else { 45 - rest };
        let contours = vessel.region_at(3.0 * f64::from(of_vessel), 128).contours;
        PlaneSections { z_mm: 3.0 * f64::from(k), contours }
    };
    let planes = (0..46 * n_copies).map(plane).collect();
    SectionStack { planes, patient_from_stack: RigidTransform::identity() }
}

/// From sections to a wall that was found valid, of a vessel that is longer and branches more often: the cost of a plane
/// stays the same.
fn checked_wall(c: &mut Criterion) {
    let mut group = c.benchmark_group("checked wall");
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    for n_copies in [1, 4, 16] {
        let stack = longer_stack(n_copies);
        group.throughput(Throughput::Elements(stack.planes.len() as u64));
        group.bench_function(format!("{n_copies} vessels"), |b| {
            b.iter(|| {
                let built =
                    build(black_box(&stack), &Params::new(Body::Wall { wall_mm: 1.0 }), &Task::quiet());
                check(&Brep::of(&built.expect("the phantom builds").solid, SkinChoice::All)).expect("valid");
            });
        });
    }
    group.finish();
}

/// Which contour continues which, the same vessel cut more finely.
fn graph(c: &mut Criterion) {
    let mut group = c.benchmark_group("graph");
    group.sample_size(10);
    for (n_planes, stack) in finer_stacks() {
        group.bench_function(format!("{n_planes} planes"), |b| {
            b.iter(|| lumenfab::topology::graph(black_box(&stack)).expect("the phantom links"));
        });
    }
    group.finish();
}

/// From sections to a solid that was found valid, the same vessel cut more finely.
fn checked_solid(c: &mut Criterion) {
    let mut group = c.benchmark_group("checked solid");
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    for (n_planes, stack) in finer_stacks() {
        group.bench_function(format!("{n_planes} planes"), |b| {
            b.iter(|| {
                let built = build(black_box(&stack), &Params::new(Body::Cast), &Task::quiet());
                check(&Brep::of(&built.expect("the phantom builds").solid, SkinChoice::All)).expect("valid");
            });
        });
    }
    group.finish();
}

fn solid(c: &mut Criterion) {
    let stack = stack();
    let mut group = c.benchmark_group("solid");
    group.sample_size(10);
    for (name, body) in [("cast", Body::Cast), ("wall", Body::Wall { wall_mm: 1.0 })] {
        group.bench_function(name, |b| {
            b.iter(|| {
                build(black_box(&stack), &Params::new(body), &Task::quiet()).expect("the phantom builds")
            });
        });
    }
    group.finish();
}

fn tessellation(c: &mut Criterion) {
    let params = Params::new(Body::Wall { wall_mm: 1.0 });
    let built = build(&stack(), &params, &Task::quiet()).expect("the phantom builds");
    let mut group = c.benchmark_group("tessellate");
    group.sample_size(10);
    for deflection_mm in [0.1, 0.03, 0.01, 0.005] {
        let how =
            Tessellation { skin: SkinChoice::All, deflection: Deflection::Absolute { mm: deflection_mm } };
        group.bench_function(format!("{deflection_mm} mm"), |b| {
            b.iter(|| tessellate(black_box(&built.solid), &how, &Task::quiet()).expect("the phantom meshes"));
        });
    }
    group.finish();
}

criterion_group!(benches, graph, checked_solid, checked_wall, solid, tessellation);
criterion_main!(benches);
