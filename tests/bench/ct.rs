//! How long the phantom's image takes, and reading its 46 planes of 512 x 512 back.
#![allow(missing_docs, clippy::unwrap_used, reason = "a bench")]

use criterion::{Criterion, criterion_group, criterion_main};
use lumenfab::ct::{SeriesChoice, reader};
use lumenfab::phantom::{self, Contrast, Kind, Params, Vessel};
use lumenfab::progress::Task;
use std::hint::black_box;

fn sections(c: &mut Criterion) {
    let vessel = Vessel::new(Kind::Carotid);
    let mut heights = (0..).map(|i| f64::from(i % 138));
    c.bench_function("phantom/region_at_128_points", |b| {
        b.iter(|| black_box(vessel.region_at(heights.next().unwrap(), 128)));
    });
}

fn images(c: &mut Criterion) {
    let mut group = c.benchmark_group("phantom/volume_46x512x512");
    group.sample_size(10);
    for (name, polarity) in [("bright", Contrast::Bright), ("dark", Contrast::Dark)] {
        let params = Params { polarity, ..Params::default() };
        group.bench_function(name, |b| b.iter(|| black_box(phantom::volume(&params, &Task::quiet()))));
    }
}

fn reading(c: &mut Criterion) {
    let place = tempfile::tempdir().unwrap();
    let dir = place.path().join("series");
    phantom::series::write(&dir, &Params::default(), &Task::quiet()).unwrap();
    let mut group = c.benchmark_group("ct");
    group.sample_size(10);
    group.bench_function("load_46x512x512", |b| {
        b.iter(|| black_box(reader::load(&dir, &SeriesChoice::Only, &Task::quiet()).unwrap()));
    });
}

criterion_group!(benches, sections, images, reading);
criterion_main!(benches);
