use super::encoder::{Options, encode};
use super::*;
use proptest::prelude::*;

fn decoded(bytes: &[u8], columns: usize, rows: usize) -> Result<Vec<u16>, Fault> {
    decode(bytes, Size { columns, rows }).map(|s| s.words)
}

/// Images with flat parts, slopes and noise, of any bit depth.
fn images() -> impl Strategy<Value = (usize, u8, Vec<u16>)> {
    (1_usize..40, 1_usize..40, 2_u8..=16, 0_u32..4).prop_flat_map(|(columns, rows, bits, roughness)| {
        let most = (1_u32 << bits) - 1;
        let noise = match roughness {
            0 => Just(0).boxed(),
            1 => prop_oneof![20 => Just(0), 1 => 0..=most].boxed(),
            2 => (0..=most.min(3)).boxed(),
            _ => (0..=most).boxed(),
        };
        let slope = 0..=most / 4;
        (prop::collection::vec(noise, columns * rows), slope).prop_map(move |(noise, slope)| {
            let value = |(i, n): (usize, u32)| {
                let base =
                    if i % columns > columns / 2 { slope * u32::try_from(i / columns).unwrap() } else { 0 };
                u16::try_from((base + n) % (most + 1)).unwrap()
            };
            (columns, bits, noise.into_iter().enumerate().map(value).collect())
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn what_was_encoded_is_decoded((columns, bits, image) in images(), restart_rows in 0_usize..12) {
        let options = Options { restart_rows, ..Options::default() };
        let bytes = encode(&image, columns, bits, &options);
        prop_assert_eq!(decoded(&bytes, columns, image.len() / columns), Ok(image));
    }

    #[test]
    fn near_lossless_samples_are_off_by_near_at_most((columns, bits, image) in images(), near in 1_u8..=40) {
        let near = near.min(u8::try_from(((1_u32 << bits) - 1) / 2).unwrap_or(u8::MAX));
        let bytes = encode(&image, columns, bits, &Options { near, ..Options::default() });
        let found = decoded(&bytes, columns, image.len() / columns).unwrap();
        prop_assert!(found.iter().zip(&image).all(|(a, b)| a.abs_diff(*b) <= u16::from(near)));
    }

    #[test]
    fn preset_parameters_are_heeded((columns, _, image) in images(), reset in 3_i32..=255, t in 2_i32..60) {
        let preset = Preset { max_value: 4000, thresholds: [t, t + 9, t + 80], reset };
        let image: Vec<u16> = image.iter().map(|&s| s % 4001).collect();
        let bytes = encode(&image, columns, 12, &Options { preset, ..Options::default() });
        prop_assert_eq!(decoded(&bytes, columns, image.len() / columns), Ok(image));
    }

    #[test]
    fn damaged_streams_never_panic(
        (columns, bits, image) in images(),
        near in 0_u8..4,
        restart_rows in 0_usize..5,
        damage in prop::collection::vec((any::<prop::sample::Index>(), 0_u8..4, any::<u8>()), 1..6),
    ) {
        let near = near.min(u8::try_from(((1_u32 << bits) - 1) / 2).unwrap_or(u8::MAX));
        let mut bytes = encode(&image, columns, bits, &Options { near, restart_rows, ..Options::default() });
        for (at, kind, byte) in damage {
            let at = at.index(bytes.len());
            match kind {
                0 => bytes[at] ^= byte,
                1 => bytes.truncate(at + 1),
                2 => bytes.insert(at, byte),
                _ => drop(bytes.remove(at)),
            }
            if bytes.is_empty() {
                break;
            }
        }
        if let Ok(words) = decoded(&bytes, columns, image.len() / columns) {
            prop_assert_eq!(words.len(), image.len());
        }
    }
}

#[test]
fn every_truncation_is_found() {
    let image: Vec<u16> = (0..400_u16).map(|i| (i * 37) % 256).collect();
    let bytes = encode(&image, 20, 8, &Options::default());
    for length in 0..bytes.len() - 3 {
        assert!(decoded(&bytes[..length], 20, 20).is_err(), "{length} of {} bytes", bytes.len());
    }
}

#[test]
fn open_heights_and_sizes_of_their_own_are_taken() {
    let image: Vec<u16> = (0..60).collect();
    for options in [
        Options { is_height_open: true, ..Options::default() },
        Options { is_oversize: true, ..Options::default() },
    ] {
        assert_eq!(decoded(&encode(&image, 10, 8, &options), 10, 6).as_ref(), Ok(&image));
    }
}

#[test]
fn another_size_is_refused_before_memory_is_taken() {
    let mut bytes = encode(&[7; 60], 10, 8, &Options::default());
    let found = Size { columns: 10, rows: 6 };
    let expected = Size { columns: 6, rows: 10 };
    assert_eq!(decode(&bytes, expected), Err(Fault::OtherSize { found, expected }));
    // Rows and columns stand behind the precision.
    bytes[7..11].copy_from_slice(&[0xff; 4]);
    assert_eq!(decoded(&bytes, 65_535, 65_535), Err(Fault::Truncated));
}

#[test]
fn colour_and_other_kinds_are_refused_by_name() {
    let bytes = encode(&[7; 60], 10, 8, &Options::default());
    let changed = |at: usize, value: u8| {
        let mut changed = bytes.clone();
        changed[at] = value;
        decoded(&changed, 10, 6).unwrap_err()
    };
    assert_eq!(changed(11, 3), Fault::Unsupported("a JPEG-LS image in colour"));
    assert!(matches!(changed(3, 0xc0), Fault::Damaged("the compressed pixels are JPEG but not JPEG-LS")));
    assert!(matches!(changed(6, 17), Fault::Damaged(_)));
    assert!(matches!(changed(0, 0), Fault::Damaged(_)));
}

#[test]
fn streams_of_another_encoder_decode_to_what_it_decodes_them_to() {
    // Made by tests/tools/codec_streams.py with CharLS: 29 x 23 samples.
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/codec");
    for (bits, near) in [(2, 0), (5, 0), (8, 0), (8, 3), (10, 1), (12, 0), (12, 5), (16, 0), (16, 7)] {
        let file = |kind| std::fs::read(folder.join(format!("bits{bits:02}_near{near}.{kind}"))).unwrap();
        let expected = file("raw").chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        assert_eq!(decoded(&file("jls"), 29, 23), Ok(expected), "{bits} bits, NEAR {near}");
    }
}
