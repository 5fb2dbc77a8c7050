//! The stacks and phases that one multi-frame object may hold, told apart so that none is merged with another.
//!
//! Frames belong together where stack, temporal position and all dimension indices agree that count anything but places
//! in space (PS3.3 C.7.6.17). Indices of unknown meaning, such as times, which may differ from plane to plane, separate frames
//! only where two lie at one place.

use super::super::SAME_PLACE_MM;
use super::super::series::Header;
use crate::geom::Point3;
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use std::collections::BTreeMap;

/// What a frame says about where it belongs.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Dimensions {
    pub(super) stack: String,
    pub(super) phase: String,
    /// One for each of the object's dimensions.
    pub(super) indices: Vec<u32>,
}

/// Dimensions that count places along a stack.
const SPATIAL: [Tag; 5] = [
    tags::IN_STACK_POSITION_NUMBER,
    tags::IMAGE_POSITION_PATIENT,
    tags::IMAGE_POSITION_VOLUME,
    tags::SLICE_LOCATION,
    tags::TABLE_POSITION,
];

/// Dimensions that never differ within a stack.
const SEPARATING: [Tag; 10] = [
    tags::STACK_ID,
    tags::IMAGE_ORIENTATION_PATIENT,
    tags::TEMPORAL_POSITION_INDEX,
    tags::TEMPORAL_POSITION_TIME_OFFSET,
    tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE,
    tags::NOMINAL_CARDIAC_TRIGGER_DELAY_TIME,
    tags::NOMINAL_PERCENTAGE_OF_RESPIRATORY_PHASE,
    tags::CONVOLUTION_KERNEL,
    tags::FRAME_TYPE,
    tags::KVP,
];

/// Makes the identities of images differ where they belong to different stacks; `pointers` says what each index counts.
pub(super) fn tell_apart(images: &mut [Header], dimensions: &[Dimensions], pointers: &[Option<Tag>]) {
    let known =
        |list: &[Tag], i: usize| pointers.get(i).copied().flatten().is_some_and(|p| list.contains(&p));
    let key = |d: &Dimensions, is_counted: &dyn Fn(usize) -> bool| -> String {
        let indices = d.indices.iter().enumerate().filter(|(i, _)| is_counted(*i));
        let indices: Vec<String> = indices.map(|(_, n)| n.to_string()).collect();
        format!("#{}#{}#{}", d.stack, d.phase, indices.join(","))
    };
    let coarse: Vec<String> = dimensions.iter().map(|d| key(d, &|i| known(&SEPARATING, i))).collect();
    let fine = dimensions.iter().map(|d| key(d, &|i| !known(&SPATIAL, i)));
    let doubled = groups_with_doubled_places(images, &coarse);
    for ((image, coarse), fine) in images.iter_mut().zip(&coarse).zip(fine) {
        image.identity[0].push_str(if doubled[coarse] { &fine } else { coarse });
    }
}

/// By key: whether two of the images that share it lie at one place.
fn groups_with_doubled_places<'k>(images: &[Header], keys: &'k [String]) -> BTreeMap<&'k String, bool> {
    let mut groups: BTreeMap<&String, Vec<&Header>> = BTreeMap::new();
    for (image, key) in images.iter().zip(keys) {
        groups.entry(key).or_default().push(image);
    }
    groups.into_iter().map(|(key, group)| (key, has_doubled_place(&group))).collect()
}

/// Along the normal, where planes are apart: across it rounding would mix up their order.
fn has_doubled_place(images: &[&Header]) -> bool {
    let normal = images[0].shape.normal();
    let mut places: Vec<(f64, Point3)> =
        images.iter().map(|h| (h.position.coords.dot(&normal), h.position)).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    places.iter().enumerate().any(|(i, (height, place))| {
        let near = places[i + 1..].iter().take_while(|p| p.0 - height < SAME_PLACE_MM);
        near.into_iter().any(|p| (p.1 - place).abs().max() < SAME_PLACE_MM)
    })
}

#[cfg(test)]
mod tests {
    use super::super::super::series::tests::header;
    use super::*;

    /// Number of different identities of images at those heights with those stacks, phases and indices.
    fn n_stacks(frames: &[(f64, &str, &str, &[u32])], pointers: &[Option<Tag>]) -> usize {
        let mut images: Vec<Header> = frames.iter().map(|f| header("file", f.0)).collect();
        let dimensions: Vec<Dimensions> = frames
            .iter()
            .map(|f| Dimensions { stack: f.1.into(), phase: f.2.into(), indices: f.3.to_vec() })
            .collect();
        tell_apart(&mut images, &dimensions, pointers);
        let mut found: Vec<&String> = images.iter().map(|i| &i.identity[0]).collect();
        found.sort();
        found.dedup();
        found.len()
    }

    #[test]
    fn stacks_and_phases_are_told_apart() {
        let spatial = [Some(tags::STACK_ID), Some(tags::IN_STACK_POSITION_NUMBER)];
        assert_eq!(n_stacks(&[(0.0, "1", "", &[1, 1]), (1.0, "1", "", &[1, 2])], &spatial), 1);
        assert_eq!(n_stacks(&[(0.0, "1", "", &[1, 1]), (1.0, "2", "", &[2, 1])], &spatial), 2);
        assert_eq!(n_stacks(&[(0.0, "", "1", &[]), (1.0, "", "2", &[])], &[]), 2);
        let cardiac = [Some(tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE), Some(tags::IMAGE_POSITION_PATIENT)];
        assert_eq!(n_stacks(&[(0.0, "", "", &[1, 1]), (1.0, "", "", &[2, 2])], &cardiac), 2);
    }

    #[test]
    fn indices_of_unknown_meaning_separate_only_what_lies_at_one_place() {
        let pointers = [Some(tags::FRAME_ACQUISITION_DATE_TIME), None];
        let along = [(0.0, "", "", &[1, 1][..]), (1.0, "", "", &[2, 2])];
        assert_eq!(n_stacks(&along, &pointers), 1);
        let twice = [
            (0.0, "", "", &[1, 1][..]),
            (1.0, "", "", &[1, 1]),
            (0.0, "", "", &[2, 1]),
            (1.0, "", "", &[2, 1]),
        ];
        assert_eq!(n_stacks(&twice, &pointers), 2);
    }

    #[test]
    fn rounding_across_the_planes_hides_no_second_time_point() {
        let mut images: Vec<Header> = (0..8).map(|k| header("file", f64::from(k / 2))).collect();
        // The planes between two of one place, were they put in order by x.
        for (image, x) in images.iter_mut().zip([0.0, 0.004, 0.001, 0.005, 0.002, 0.006, 0.003, 0.007]) {
            image.position.x += x;
        }
        let keys = vec![String::new(); 8];
        assert!(groups_with_doubled_places(&images, &keys)[&keys[0]]);
        let apart: Vec<Header> = images.into_iter().step_by(2).collect();
        assert!(!groups_with_doubled_places(&apart, &keys[..4])[&keys[0]]);
    }
}
