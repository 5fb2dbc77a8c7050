//! Image headers to stacks: which images belong together. Pure.
//!
//! Images are grouped by series and frame of reference, then by size, spacing and orientation, then by what makes another
//! image of the same place ([`Trait::KINDS`]). Where images of one group still lie at the same places, the group is split by
//! the first of [`Trait::RUNS`] that leaves fewer such places and only parts of [`LEAST_STACK`] images or more. Nothing is ever merged.
//! Fewer images than that are strays: scout views and images of another kind are left out, images of another size
//! are kept aside, for they may be damaged planes of the stack.

use super::SAME_PLACE_MM;
use super::series::{Header, Series};
use super::traits::Trait;
use std::collections::BTreeMap;

/// Fewer images of another shape or kind in one DICOM series are strays, not a stack of their own.
const LEAST_STACK: usize = 3;

/// Groups images into stacks, in the order in which they first occur; the runs of one DICOM series by their values.
pub(super) fn group(headers: Vec<Header>) -> Vec<Series> {
    let by_series = partition(headers, |h| h.identity.clone());
    by_series.into_iter().flat_map(stacks_of_series).collect()
}

/// Parts of equal keys, in the order in which these first occur.
fn partition<K: Ord>(headers: Vec<Header>, key: impl Fn(&Header) -> K) -> Vec<Vec<Header>> {
    let mut index = BTreeMap::new();
    let mut parts: Vec<Vec<Header>> = Vec::new();
    for header in headers {
        let place = *index.entry(key(&header)).or_insert(parts.len());
        if place == parts.len() {
            parts.push(Vec::new());
        }
        parts[place].push(header);
    }
    parts
}

fn stacks_of_series(headers: Vec<Header>) -> Vec<Series> {
    let mut parts: Vec<Vec<Header>> = Vec::new();
    for header in headers {
        let is_like = |part: &Vec<Header>| {
            part[0].shape.is_like(&header.shape) && part[0].traits.kind() == header.traits.kind()
        };
        match parts.iter_mut().find(|part| is_like(part)) {
            Some(part) => part.push(header),
            None => parts.push(vec![header]),
        }
    }
    let (stacks, strays) = strays_apart(parts);
    let mut stacks: Vec<Series> = stacks.into_iter().flat_map(split_by_runs).map(series).collect();
    distinguish(&mut stacks);
    set_aside(strays, &mut stacks);
    stacks
}

/// Parts that are stacks of their own, and the rest. The largest always is one.
fn strays_apart(parts: Vec<Vec<Header>>) -> (Vec<Vec<Header>>, Vec<Header>) {
    let most = parts.iter().map(Vec::len).max().unwrap_or(0);
    // The first of the largest: max_by_key would take the last.
    let largest = parts.iter().position(|p| p.len() == most);
    let mut stacks = Vec::new();
    let mut strays = Vec::new();
    for (i, part) in parts.into_iter().enumerate() {
        if Some(i) == largest || part.len() >= LEAST_STACK { stacks.push(part) } else { strays.extend(part) }
    }
    (stacks, strays)
}

/// Splits images that lie at the same places by what may tell them apart.
fn split_by_runs(images: Vec<Header>) -> Vec<Vec<Header>> {
    let n_before = n_sharing_a_place(&images);
    if n_before == 0 {
        return vec![images];
    }
    let is_better = |parts: &Vec<Vec<Header>>| {
        let is_stack = |p: &Vec<Header>| p.len() >= LEAST_STACK;
        parts.iter().all(is_stack) && parts.iter().map(|p| n_sharing_a_place(p)).sum::<usize>() < n_before
    };
    let by = |run: Trait| partition(images.clone(), |h| h.traits.get(run).to_owned());
    let Some((run, mut parts)) =
        Trait::RUNS.into_iter().map(|run| (run, by(run))).find(|(_, p)| is_better(p))
    else {
        return vec![images];
    };
    let value = |part: &Vec<Header>| part[0].traits.get(run).parse::<f64>().unwrap_or(f64::INFINITY);
    parts.sort_by(|a, b| value(a).total_cmp(&value(b)));
    parts.into_iter().flat_map(split_by_runs).collect()
}

/// How many images lie where another one lies already; copies of one file aside.
fn n_sharing_a_place(images: &[Header]) -> usize {
    let normal = images[0].shape.normal();
    let mut places: Vec<(f64, &str)> =
        images.iter().map(|h| (h.position.coords.dot(&normal), h.instance.as_str())).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(b.1)));
    let share =
        |w: &[(f64, &str)]| w[1].0 - w[0].0 < SAME_PLACE_MM && (w[0].1 != w[1].1 || w[0].1.is_empty());
    places.windows(2).filter(|w| share(w)).count()
}

fn series(images: Vec<Header>) -> Series {
    let first = &images[0];
    let mut key = first.identity.to_vec();
    key.push(first.shape.describe());
    key.extend(first.traits.kind().map(str::to_owned));
    Series { odd: Vec::new(), n_across: 0, n_other_kind: 0, distinction: String::new(), key, images }
}

/// Says what tells the stacks of one DICOM series apart.
fn distinguish(stacks: &mut [Series]) {
    let value = |s: &Series, t: Trait| s.images[0].traits.get(t).to_owned();
    let kinds_and_runs = Trait::KINDS.into_iter().chain(Trait::RUNS);
    let is_one = |s: &Series, t: Trait| s.images.iter().all(|h| h.traits.get(t) == s.images[0].traits.get(t));
    let telling: Vec<Trait> = kinds_and_runs
        .filter(|&t| {
            stacks.iter().all(|s| is_one(s, t)) && stacks.iter().any(|s| value(s, t) != value(&stacks[0], t))
        })
        .collect();
    for stack in stacks {
        let shown = telling.iter().filter_map(|&t| t.shown(stack.images[0].traits.get(t)));
        stack.distinction = shown.collect::<Vec<_>>().join(", ");
        stack.key.extend(telling.iter().map(|&t| stack.images[0].traits.get(t).to_owned()));
    }
}

/// Gives the strays of a DICOM series to its largest stack: told there, used nowhere.
fn set_aside(strays: Vec<Header>, stacks: &mut [Series]) {
    let Some(largest) = stacks.iter().map(|s| s.images.len()).max() else { return };
    let Some(stack) = stacks.iter_mut().find(|s| s.images.len() == largest) else { return };
    for stray in strays {
        let shape = &stack.images[0].shape;
        if stray.shape.is_like(shape) {
            stack.n_other_kind += 1;
        } else if stray.shape.lies_like(shape) {
            stack.odd.push(stray);
        } else {
            stack.n_across += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::series::listing;
    use super::super::series::tests::header;
    use super::*;
    use crate::geom::Vector3;

    fn of_series(name: &str, z: f64, series: &str) -> Header {
        Header { identity: [series.into(), "frame".into()], ..header(name, z) }
    }

    fn with(mut header: Header, of: Trait, value: &str) -> Header {
        header.traits.0[of as usize] = value.into();
        header
    }

    fn sizes(found: &[Series]) -> Vec<usize> {
        found.iter().map(|s| s.images.len()).collect()
    }

    /// Two runs of `n` images each at the same heights, told apart by one attribute.
    fn two_runs(n: u8, of: Trait, values: [&str; 2]) -> Vec<Header> {
        let run = |value: &'static str| {
            (0..n).map(move |k| with(header(&format!("{value} {k}"), f64::from(k)), of, value))
        };
        let values = values.map(|v| &*v.to_owned().leak());
        run(values[0]).chain(run(values[1])).collect()
    }

    #[test]
    fn series_are_told_apart_by_identity_in_order_of_their_files() {
        let headers = vec![of_series("a", 0.0, "9"), of_series("b", 0.0, "1"), of_series("c", 1.0, "9")];
        let found = group(headers);
        assert_eq!(sizes(&found), [2, 1]);
        let text = listing(&found);
        assert!(text.starts_with("1: CT, 2 images, 4 x 3 pixels of 0.5000 x 0.8000 mm"), "{text}");
    }

    #[test]
    fn a_stray_size_is_odd_and_a_whole_stack_is_its_own() {
        let mut headers: Vec<Header> = (0..8).map(|i| header(&format!("{i}"), f64::from(i))).collect();
        headers[2].shape.rows = 5;
        let found = group(headers.clone());
        assert_eq!((sizes(&found), found[0].odd.len()), (vec![7], 1));
        for header in &mut headers[5..] {
            header.shape.axes = [Vector3::y(), Vector3::z()];
        }
        let found = group(headers);
        assert_eq!((sizes(&found), found[0].odd.len()), (vec![4, 3], 1));
    }

    #[test]
    fn a_scout_view_and_an_image_of_another_kind_are_left_out() {
        let mut headers: Vec<Header> = (0..6).map(|i| header(&format!("{i}"), f64::from(i))).collect();
        headers[0].shape.axes = [Vector3::y(), Vector3::z()];
        headers[1] = with(headers[1].clone(), Trait::Kernel, "B60f");
        let found = group(headers);
        assert_eq!((sizes(&found), found[0].n_across, found[0].n_other_kind), (vec![4], 1, 1));
    }

    #[test]
    fn kinds_are_told_apart_wherever_their_images_lie() {
        for of in Trait::KINDS {
            let headers = (0..8)
                .map(|k| with(header(&format!("{k}"), f64::from(k)), of, if k < 4 { "30" } else { "60" }));
            assert_eq!(sizes(&group(headers.collect())), [4, 4], "{of:?}");
        }
    }

    #[test]
    fn runs_are_told_apart_where_images_lie_at_the_same_places_and_sorted_by_value() {
        for of in Trait::RUNS {
            let found = group(two_runs(4, of, ["70", "9"]));
            assert_eq!(sizes(&found), [4, 4], "{of:?}");
            assert_eq!(found[0].images[0].traits.get(of), "9");
        }
        let found = group(two_runs(4, Trait::CardiacPhase, ["30", "70"]));
        assert_eq!(
            [&found[0].distinction, &found[1].distinction],
            ["cardiac phase 30 %", "cardiac phase 70 %"]
        );
        assert!(listing(&found).contains("cardiac phase 70 %"));
    }

    #[test]
    fn an_acquisition_a_plane_is_one_stack() {
        let headers =
            (0..6).map(|k| with(header(&format!("{k}"), f64::from(k)), Trait::Acquisition, &k.to_string()));
        let mut headers: Vec<Header> = headers.collect();
        assert_eq!(sizes(&group(headers.clone())), [6]);
        // One plane scanned twice does not make six stacks of it.
        headers.push(with(header("again", 3.0), Trait::Acquisition, "9"));
        assert_eq!(sizes(&group(headers)), [7]);
    }

    #[test]
    fn copies_of_files_are_no_run() {
        let mut headers = two_runs(4, Trait::Acquisition, ["1", "2"]);
        for k in 0..4 {
            headers[k + 4].instance = headers[k].instance.clone();
        }
        assert_eq!(sizes(&group(headers)), [8]);
    }

    #[test]
    fn two_attributes_together_tell_four_runs_apart() {
        let mut headers = Vec::new();
        for (a, b) in [("1", "30"), ("1", "70"), ("2", "30"), ("2", "70")] {
            for k in 0..3 {
                let header = header(&format!("{a} {b} {k}"), f64::from(k));
                headers.push(with(with(header, Trait::Acquisition, a), Trait::CardiacPhase, b));
            }
        }
        let found = group(headers);
        assert_eq!(sizes(&found), [3, 3, 3, 3]);
        assert_eq!(found[1].distinction, "cardiac phase 30 %, acquisition 2");
    }

    #[test]
    fn a_check_finds_its_series_again_and_depends_on_the_salt() {
        let found = group(two_runs(4, Trait::CardiacPhase, ["30", "70"]));
        let again = group(two_runs(4, Trait::CardiacPhase, ["30", "70"]));
        assert_eq!(found[1].check("case"), again[1].check("case"));
        assert_ne!(found[0].check("case"), found[1].check("case"));
        assert_ne!(found[0].check("case"), found[0].check("other"));
        assert_eq!(found[0].check("case").len(), 32);
    }
}
