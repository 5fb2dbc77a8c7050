//! Layers from an analytic body: the grid, and 690 cuts of a vessel wall.

use criterion::{Criterion, criterion_group, criterion_main};
use lumenfab::geom::{Contour, Point2, Region};
use lumenfab::progress::Task;
use lumenfab::slice::{GridParams, grid, slice_solid};
use lumenfab::solid::{CrossSection, Sectioned};

const PARAMS: GridParams = GridParams { layer_mm: 0.2, height_limits_mm: [0.05, 0.32] };

/// Two leaning tubes that become one: the shape of a merge without the cost of a solid.
struct Fork;

impl Fork {
    fn union(z_mm: f64, radius_mm: f64) -> Region {
        let lean = 7.0 - 0.07 * z_mm;
        let disk = |x: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.03 * z_mm), radius_mm, 150)]);
        disk(-lean).union(&disk(lean))
    }
}

impl Sectioned for Fork {
    fn z_range_mm(&self) -> [f64; 2] {
        [-1.5, 136.5]
    }

    fn section(&self, z_mm: f64, _tolerance_mm: f64) -> CrossSection {
        CrossSection { outer: Self::union(z_mm, 3.8), lumen: Self::union(z_mm, 2.8) }
    }
}

fn slicing(criterion: &mut Criterion) {
    let planes: Vec<f64> = (0..46).map(|k| 3.0 * f64::from(k)).collect();
    let irregular: Vec<f64> = (0..500).map(|k| 0.7 * f64::from(k) + 0.2 * f64::from(k * k % 7)).collect();
    criterion.bench_function("grid of 46 even planes", |b| b.iter(|| grid(&planes, [-1.5, 136.5], &PARAMS)));
    let end = irregular[499] + 0.5;
    criterion
        .bench_function("grid of 500 uneven planes", |b| b.iter(|| grid(&irregular, [-0.5, end], &PARAMS)));
    let table = grid(&planes, [-1.5, 136.5], &PARAMS).expect("the reference case has a grid");
    let mut group = criterion.benchmark_group("slice");
    group.sample_size(10);
    group.bench_function("690 layers of a fork", |b| {
        b.iter(|| slice_solid(&Fork, &table, 1e-3, &Task::quiet()))
    });
    group.finish();
}

criterion_group!(benches, slicing);
criterion_main!(benches);
