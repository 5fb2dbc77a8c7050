//! 690 layers of a vessel wall to beads, to G-code, to a time estimate.

use criterion::{Criterion, criterion_group, criterion_main};
use lumenfab::geom::{Contour, Point2, Region};
use lumenfab::progress::Task;
use lumenfab::slice::{Layer, LayerSlot};
use lumenfab::{gcode, motion, profile, toolpath};

/// Two leaning tubes that become one, with a wall of 1 mm (`cast`: solid).
fn layers(cast: bool) -> Vec<Layer> {
    let layer = |i: u32| {
        let z_mid_mm = 0.2 * (f64::from(i) + 0.5);
        let lean = 7.0 - 0.07 * z_mid_mm;
        let disk =
            |x: f64, r: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.03 * z_mid_mm), r, 150)]);
        let union = |r: f64| disk(-lean, r).union(&disk(lean, r));
        let lumen = if cast { Region::default() } else { union(2.8) };
        let material = if cast { union(2.8) } else { union(3.8).difference(&lumen) };
        Layer { slot: LayerSlot { z_mid_mm, height_mm: 0.2, ct_plane: None }, material, lumen }
    };
    (0..690).map(layer).collect()
}

fn planning(criterion: &mut Criterion) {
    let profile = profile::builtin("reference").expect("a built-in profile");
    let task = Task::quiet();
    let mut group = criterion.benchmark_group("toolpath");
    group.sample_size(10);
    for (name, cast) in [("wall", false), ("cast", true)] {
        let layers = layers(cast);
        group.bench_function(format!("690 layers of a {name}"), |b| {
            b.iter(|| toolpath::plan(&layers, &profile, &task));
        });
    }
    // Every outline is looked for on those below.
    let steadied = profile::builtin("prusa-mk3s").expect("a built-in profile");
    let slender = layers(true);
    group.bench_function("690 layers of a cast that gets a brim", |b| {
        b.iter(|| toolpath::plan(&slender, &steadied, &task));
    });
    let planned = toolpath::plan(&layers(false), &profile, &task).expect("it fits the bed");
    let header = gcode::Header::default();
    group.bench_function("G-code of 690 layers", |b| {
        b.iter(|| gcode::write(&planned.paths, &profile, &header))
    });
    let text = gcode::write(&planned.paths, &profile, &header);
    group.bench_function("estimate of 690 layers", |b| b.iter(|| motion::estimate(&text, &profile, &task)));
    group.finish();
}

criterion_group!(benches, planning);
criterion_main!(benches);
