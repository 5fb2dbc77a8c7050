use super::encoder::{Lossless, lossless, sequential};
use super::*;
use proptest::prelude::*;

fn decoded(bytes: &[u8], columns: usize, rows: usize) -> Result<Vec<u16>, Fault> {
    decode(bytes, Size { columns, rows }).map(|s| s.words)
}

/// Images of any of those bit depths, noisy all over or here and there.
fn images(bits: impl Strategy<Value = u8>) -> impl Strategy<Value = (usize, u8, Vec<u16>)> {
    (1_usize..30, 1_usize..30, bits, any::<bool>()).prop_flat_map(|(columns, rows, bits, is_noisy)| {
        let most = u16::try_from((1_u32 << bits) - 1).unwrap();
        let value = if is_noisy {
            (0..=most).boxed()
        } else {
            prop_oneof![9 => Just(most / 3), 1 => 0..=most].boxed()
        };
        prop::collection::vec(value, columns * rows).prop_map(move |image| (columns, bits, image))
    })
}

/// Changes, cuts, insertions and removals at some places.
fn damages() -> impl Strategy<Value = Vec<(prop::sample::Index, u8, u8)>> {
    prop::collection::vec((any::<prop::sample::Index>(), 0_u8..4, any::<u8>()), 1..6)
}

fn damaged(mut bytes: Vec<u8>, damages: Vec<(prop::sample::Index, u8, u8)>) -> Vec<u8> {
    for (at, kind, byte) in damages {
        let at = at.index(bytes.len());
        match kind {
            0 => bytes[at] ^= byte,
            1 => bytes.truncate(at + 1),
            2 => bytes.insert(at, byte),
            _ => drop((bytes.len() > 1).then(|| bytes.remove(at))),
        }
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn lossless_images_come_back(
        (columns, bits, image) in images(2_u8..=16),
        predictor in 1_u8..=7,
        point_transform in 0_u8..3,
        restart_rows in 0_usize..12,
    ) {
        let point_transform = point_transform.min(bits - 1);
        let image: Vec<u16> = image.iter().map(|s| s >> point_transform << point_transform).collect();
        let bytes = lossless(&image, columns, bits, Lossless { predictor, point_transform, restart_rows });
        prop_assert_eq!(decoded(&bytes, columns, image.len() / columns), Ok(image));
    }

    #[test]
    fn sequential_images_come_back_within_their_steps(
        (columns, bits, image) in images(prop_oneof![Just(8_u8), Just(12)]),
        restart_blocks in 0_usize..4,
    ) {
        let bytes = sequential(&image, columns, bits, restart_blocks);
        let found = decoded(&bytes, columns, image.len() / columns).unwrap();
        // 64 coefficients of an orthonormal transform, each off by a half at most: 4 in a sample (Cauchy and Schwarz), 16 for
        // the squares of a block (Parseval), and the rounding of each sample.
        let off: Vec<f64> = found.iter().zip(&image).map(|(a, b)| f64::from(a.abs_diff(*b))).collect();
        let worst = off.iter().copied().fold(0.0, f64::max);
        prop_assert!(worst <= 4.0, "{worst}");
        let n_blocks = columns.div_ceil(8) * (image.len() / columns).div_ceil(8);
        let together = off.iter().map(|d| d * d).sum::<f64>().sqrt();
        let most = 4.0 * (n_blocks as f64).sqrt() + 0.5 * (image.len() as f64).sqrt();
        prop_assert!(together <= most, "{together} of {most}");
    }

    #[test]
    fn damaged_lossless_streams_never_panic(
        (columns, bits, image) in images(2_u8..=16),
        predictor in 1_u8..=7,
        restart_rows in 0_usize..5,
        damages in damages(),
    ) {
        let whole = lossless(&image, columns, bits, Lossless { predictor, point_transform: 0, restart_rows });
        if let Ok(words) = decoded(&damaged(whole, damages), columns, image.len() / columns) {
            prop_assert_eq!(words.len(), image.len());
        }
    }

    #[test]
    fn damaged_sequential_streams_never_panic(
        (columns, bits, image) in images(prop_oneof![Just(8_u8), Just(12)]),
        restart_blocks in 0_usize..4,
        damages in damages(),
    ) {
        let whole = sequential(&image, columns, bits, restart_blocks);
        if let Ok(words) = decoded(&damaged(whole, damages), columns, image.len() / columns) {
            prop_assert_eq!(words.len(), image.len());
        }
    }
}

#[test]
fn every_truncation_is_found() {
    let image: Vec<u16> = (0..400_u16).map(|i| (i * 37) % 256).collect();
    let how = Lossless { predictor: 1, point_transform: 0, restart_rows: 5 };
    for bytes in [lossless(&image, 20, 8, how), sequential(&image, 20, 8, 2)] {
        for length in 0..bytes.len() - 3 {
            assert!(decoded(&bytes[..length], 20, 20).is_err(), "{length} of {} bytes", bytes.len());
        }
    }
}

#[test]
fn what_is_not_read_is_refused_by_name() {
    let how = Lossless { predictor: 1, point_transform: 0, restart_rows: 0 };
    let bytes = lossless(&[7; 60], 10, 8, how);
    let changed = |at: usize, value: u8| {
        let mut changed = bytes.clone();
        changed[at] = value;
        decoded(&changed, 10, 6).unwrap_err()
    };
    assert_eq!(
        changed(3, 0xc2).to_string(),
        "a progressive, hierarchical or arithmetic-coded JPEG image is not supported"
    );
    assert_eq!(changed(11, 3), Fault::Unsupported("a JPEG image in colour"));
    assert!(matches!(changed(8, 9), Fault::OtherSize { found: Size { columns: 10, rows: 9 }, .. }));
    assert!(matches!(changed(6, 17), Fault::Damaged(_)));
}
