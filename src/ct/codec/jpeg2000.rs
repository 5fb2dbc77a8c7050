//! JPEG 2000 by the `jpeg2k` library, whose decoder is a translation of OpenJPEG to Rust.
//!
//! It believes what a stream says of its size and of its parts, and panics on some damaged ones: so the size segment (ITU-T T.800
//! A.5.1) and the coding styles (A.6.1, A.6.2) are read here first, and panics are caught. The library is given the codestream that was checked, without the boxes of a file
//! around it, in which another one might hide. A stream that ends early is refused, not filled up.

use super::{Fault, Samples, Size, panics_caught};
use jpeg2k::{DecodeParameters, Image, ImageComponent};

/// Start of codestream and the size segment, which must come first.
const START: [u8; 4] = [0xff, 0x4f, 0xff, 0x51];
/// How far into a file with boxes around it the codestream may begin.
const LONGEST_BOXES: usize = 4096;
/// More tiles than this make no image: memory is set aside for each.
const MOST_TILES: u32 = 4096;

/// Markers of the coding style, of one component's, of a tile part and of its data.
const COD: u8 = 0x52;
const COC: u8 = 0x53;
const SOT: u8 = 0x90;
const SOD: u8 = 0x93;
/// All markers of segments (T.800 table A.2; those of T.801 and T.814 that the decoder knows). It looks for the next known one behind
/// any other, whatever length that has, so a segment could hide there.
const KNOWN: [u8; 20] = [
    0x50, 0x51, COD, COC, 0x55, 0x57, 0x58, 0x5c, 0x5d, 0x5e, 0x5f, 0x60, 0x61, 0x63, 0x64, 0x74, 0x75, 0x77,
    0x78, SOT,
];
/// Pixels of an image for each of its precincts, on the average: the decoder sets aside about a kilobyte for one, whatever is in it.
/// Encoders make them of 32 x 32 samples and more.
const PIXELS_PER_PRECINCT: u64 = 256;
/// So many precincts are no burden however small the image is.
const FEW_PRECINCTS: u64 = 4096;
/// Layers of all precincts: two bytes for each.
const LAYERS_PER_PRECINCT: u64 = 64;
/// Where a coding style names its wavelets, and the ones whose numbers are rounded (the 9-7 filter).
const TRANSFORM: usize = 4;
const IRREVERSIBLE: u8 = 0;
/// Code blocks are 32 x 32 or 64 x 64 as a rule; one of fewer samples than this has more about it than in it.
const LEAST_BLOCK_SAMPLES_LOG2: u8 = 6;

/// Decodes one image.
pub(super) fn decode(bytes: &[u8], size: Size) -> Result<Samples, Fault> {
    let stream = codestream(bytes)?;
    check_size(stream, size)?;
    let is_lossless = check_styles(stream, size)?;
    let strict = DecodeParameters::new().strict(true);
    let image = panics_caught(|| Image::from_bytes_with(stream, strict));
    let Some(Ok(image)) = image else {
        return Err(Fault::Damaged("the JPEG 2000 pixels cannot be decoded"));
    };
    match image.components() {
        [component] => Ok(Samples { is_lossless, ..samples(component, size)? }),
        _ => Err(Fault::Unsupported("a JPEG 2000 image in colour")),
    }
}

fn samples(component: &ImageComponent, size: Size) -> Result<Samples, Fault> {
    let found = Size { columns: component.width() as usize, rows: component.height() as usize };
    if found != size {
        return Err(Fault::OtherSize { found, expected: size });
    }
    let data = panics_caught(|| component.data()).filter(|d| d.len() == size.n_pixels());
    let data = data.ok_or(Fault::Damaged("the JPEG 2000 pixels are not as many as it says"))?;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "16 bits at most, checked first"
    )]
    let words = data.iter().map(|&v| v as u16).collect();
    let (precision_bits, is_signed) = (component.precision(), component.is_signed());
    Ok(Samples { words, precision_bits, is_signed, is_lossless: true })
}

/// The codestream, where boxes of a file stand before it.
fn codestream(bytes: &[u8]) -> Result<&[u8], Fault> {
    let head = &bytes[..bytes.len().min(LONGEST_BOXES)];
    let at = head.windows(START.len()).position(|w| w == START);
    at.map(|at| &bytes[at..]).ok_or(Fault::Damaged("the compressed pixels hold no JPEG 2000 codestream"))
}

/// Checks what the codestream says before a decoder believes it.
fn check_size(stream: &[u8], expected: Size) -> Result<(), Fault> {
    let segment = stream.get(4..45).ok_or(Fault::Truncated)?;
    let word = |i: usize| u32::from_be_bytes([segment[i], segment[i + 1], segment[i + 2], segment[i + 3]]);
    let [right, bottom, left, top, tile_width, tile_height] = [4, 8, 12, 16, 20, 24].map(word);
    let found =
        Size { columns: right.saturating_sub(left) as usize, rows: bottom.saturating_sub(top) as usize };
    if found != expected {
        return Err(Fault::OtherSize { found, expected });
    }
    let n_components = u16::from_be_bytes([segment[36], segment[37]]);
    if n_components != 1 || segment[39..41] != [1, 1] {
        return Err(Fault::Unsupported("a JPEG 2000 image in colour or of fewer samples than pixels"));
    }
    if segment[38] & 0x7f > 15 {
        return Err(Fault::Unsupported("a JPEG 2000 image of more than 16 bits"));
    }
    if tile_width == 0 || tile_height == 0 {
        return Err(Fault::Damaged("the JPEG 2000 tiles have no size"));
    }
    if right.div_ceil(tile_width).saturating_mul(bottom.div_ceil(tile_height)) > MOST_TILES {
        return Err(Fault::Damaged("the JPEG 2000 pixels have too many tiles"));
    }
    Ok(())
}

/// Checks that no coding style makes precincts, layers or code blocks that take more memory than the image. Whether all of them are
/// reversible; what was left out of the stream does not tell.
fn check_styles(stream: &[u8], size: Size) -> Result<bool, Fault> {
    let most = (size.n_pixels() as u64 / PIXELS_PER_PRECINCT).max(FEW_PRECINCTS);
    // Of a component's own style the layers are those of the image.
    let mut n_layers = 1;
    let mut is_reversible = true;
    for segment in segments(stream) {
        let (flags, style) = match segment? {
            // Progression and colours stand around the layers.
            (COD, &[flags, _, high, low, _, ref style @ ..]) => {
                n_layers = u64::from(u16::from_be_bytes([high, low]));
                (flags, style)
            }
            (COC, &[_, flags, ref style @ ..]) => (flags, style),
            _ => continue,
        };
        let n_precincts =
            if flags & 1 == 1 { n_precincts(style, size) } else { FEW_PRECINCTS / LAYERS_PER_PRECINCT };
        if n_precincts > most || n_precincts.saturating_mul(n_layers) > LAYERS_PER_PRECINCT * most {
            return Err(Fault::Damaged("the JPEG 2000 pixels have too many precincts"));
        }
        if let [_, width, height, ..] = style
            && (width & 0xf) + (height & 0xf) + 4 < LEAST_BLOCK_SAMPLES_LOG2
            && size.n_pixels() as u64 > FEW_PRECINCTS
        {
            return Err(Fault::Damaged("the JPEG 2000 pixels have too many code blocks"));
        }
        is_reversible &= style.get(TRANSFORM) != Some(&IRREVERSIBLE);
    }
    Ok(is_reversible)
}

/// Precincts of all resolutions together, as if the image were one tile: `style` is the number of levels, four numbers of
/// other use, and for each resolution from the smallest on the two exponents of a precinct's sides.
fn n_precincts(style: &[u8], size: Size) -> u64 {
    let [n_levels, _, _, _, _, exponents @ ..] = style else { return 0 };
    let along = |n: usize, level: u8, exponent: u8| {
        // Each level halves the image; the standard allows 32.
        let side = (n as u64).div_ceil(1 << u32::from(level.min(32)));
        side.div_ceil(1 << u32::from(exponent))
    };
    let of = |(resolution, sides): (u8, &u8)| {
        let level = n_levels.saturating_sub(resolution);
        along(size.columns, level, sides & 0xf) * along(size.rows, level, sides >> 4)
    };
    (0..=*n_levels).zip(exponents).map(of).sum()
}

/// Markers and contents of the segments of the main header and of those of the tile parts (T.800 A.1), up to the end of the codestream
/// or of its bytes. A header that cannot be followed to its end ends them with a fault.
fn segments(stream: &[u8]) -> impl Iterator<Item = Result<(u8, &[u8]), Fault>> {
    // Behind the start of the codestream, which stands alone.
    let mut at = 2;
    let mut next_part = None;
    let mut is_lost = false;
    std::iter::from_fn(move || {
        if is_lost {
            return None;
        }
        if stream.get(at..at + 2) == Some(&[0xff, SOD]) {
            at = next_part.filter(|&next| next > at)?;
            // Behind a tile part stands another one, or the end.
            if stream.get(at..at + 2) != Some(&[0xff, SOT]) {
                return None;
            }
        }
        let segment = segment_at(stream, at);
        is_lost = segment.is_none();
        let Some((marker, segment)) = segment else {
            return Some(Err(Fault::Damaged("the JPEG 2000 header cannot be followed")));
        };
        if let (SOT, &[_, _, a, b, c, d, ..]) = (marker, segment) {
            let length = u32::from_be_bytes([a, b, c, d]) as usize;
            next_part = Some(at.saturating_add(length));
        }
        at += 4 + segment.len();
        Some(Ok((marker, segment)))
    })
}

fn segment_at(stream: &[u8], at: usize) -> Option<(u8, &[u8])> {
    let &[0xff, marker, high, low] = stream.get(at..at + 4)? else { return None };
    let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
    KNOWN.contains(&marker).then_some((marker, stream.get(at + 4..end)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size { columns: 37, rows: 33 };

    /// A stream of tests/tools/codec_streams.py and the words that OpenJPEG itself decodes from it.
    fn stream(name: &str) -> (Vec<u8>, Vec<u16>) {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/codec");
        let file = |kind| std::fs::read(folder.join(format!("{name}.{kind}"))).unwrap();
        (file("j2k"), file("raw").chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect())
    }

    #[test]
    fn an_irreversible_transform_is_told() {
        let (mut bytes, _) = stream("bits12_signed");
        assert_eq!(check_styles(&bytes, SIZE), Ok(true));
        // Marker, length, flags, order, layers, colours; then the style.
        let style = bytes.windows(2).position(|w| w == [0xff, COD]).unwrap() + 9;
        assert_eq!(std::mem::replace(&mut bytes[style + TRANSFORM], IRREVERSIBLE), 1);
        assert_eq!(check_styles(&bytes, SIZE), Ok(false));
    }

    #[test]
    fn streams_of_another_encoder_decode_to_what_it_decodes_them_to() {
        for (bits, is_signed) in [(8, false), (12, false), (12, true), (16, true)] {
            let sign = if is_signed { "signed" } else { "unsigned" };
            let (bytes, words) = stream(&format!("bits{bits:02}_{sign}"));
            let expected = Samples { words, precision_bits: bits, is_signed, is_lossless: true };
            assert_eq!(decode(&bytes, SIZE), Ok(expected), "{bits} bits, {sign}");
        }
    }

    #[test]
    fn streams_that_end_early_are_refused() {
        let (bytes, _) = stream("bits12_unsigned");
        for length in [0, 10, 60, bytes.len() / 2, bytes.len() * 9 / 10] {
            assert!(decode(&bytes[..length], SIZE).is_err(), "{length} of {} bytes", bytes.len());
        }
    }

    #[test]
    fn any_damaged_byte_is_survived() {
        let (whole, _) = stream("bits12_signed");
        for at in 0..whole.len() {
            for change in [0x01, 0x5a, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] ^= change;
                if let Ok(samples) = decode(&bytes, SIZE) {
                    assert_eq!(samples.words.len(), SIZE.n_pixels(), "byte {at}");
                }
            }
        }
    }

    #[test]
    fn the_stream_that_was_checked_is_the_one_that_is_decoded() {
        // Boxes of a file whose codestream is a large one, with a small one as a decoy before it.
        let (small, words) = stream("bits12_unsigned");
        let mut large = small.clone();
        large[8..12].copy_from_slice(&[0, 0, 0x20, 0]);
        let boxed = |kind: &[u8; 4], content: &[u8]| {
            let length = u32::try_from(content.len() + 8).unwrap().to_be_bytes();
            [&length[..], kind, content].concat()
        };
        let signature = boxed(b"jP  ", &[0x0d, 0x0a, 0x87, 0x0a]);
        let file = [signature.clone(), boxed(b"uuid", &small), boxed(b"jp2c", &large)].concat();
        if let Ok(samples) = decode(&file, SIZE) {
            assert_eq!(samples.words, words);
        }
        let plain = [signature, boxed(b"jp2c", &small)].concat();
        assert_eq!(decode(&plain, SIZE).unwrap().words, words);
    }

    #[test]
    fn precincts_are_counted_before_the_library_sets_memory_aside() {
        let (bytes, _) = stream("bits08_unsigned");
        let of_style = |stream: &[u8]| segments(stream).flatten().find(|s| s.0 == COD).unwrap().1.to_vec();
        let style = of_style(&bytes);
        let n_levels = style[5];
        let at = bytes.windows(2).position(|w| w == [0xff, COD]).unwrap();
        // The same stream as one of 4096 x 4096 pixels in one tile, with precincts of the given sides.
        let with_precincts = |exponents: u8| {
            let mut style = style.clone();
            style[0] |= 1;
            style.extend(vec![exponents; usize::from(n_levels) + 1]);
            let mut stream = bytes.clone();
            for offset in [8, 12, 24, 28] {
                stream[offset..offset + 4].copy_from_slice(&4096_u32.to_be_bytes());
            }
            let length = u16::try_from(style.len() + 2).unwrap().to_be_bytes();
            stream.splice(
                at + 2..at + 4 + style.len() - usize::from(n_levels) - 1,
                [&length[..], &style].concat(),
            );
            stream
        };
        let size = Size { columns: 4096, rows: 4096 };
        let checked = |exponents| {
            let stream = with_precincts(exponents);
            check_size(&stream, size).and_then(|()| check_styles(&stream, size))
        };
        assert_eq!(checked(0x77), Ok(true));
        assert_eq!(checked(0x11), Err(Fault::Damaged("the JPEG 2000 pixels have too many precincts")));
        assert_eq!(n_precincts(&[1, 0, 0, 0, 0, 0x00, 0x11], Size { columns: 8, rows: 6 }), 4 * 3 + 4 * 3);
        // A tile part may bring a style of its own.
        let mut stream = bytes.clone();
        let tile = segments(&bytes).flatten().position(|s| s.0 == SOT);
        assert!(tile.is_some(), "the headers are followed to the tiles");
        stream.truncate(at);
        assert!(segments(&stream).flatten().all(|s| s.0 != COD));
        // The decoder goes on two bytes behind an unknown marker, whatever length that has.
        let lost = Err(Fault::Damaged("the JPEG 2000 header cannot be followed"));
        for length in [[0xff, 0xff], [0, 2], [0, 0]] {
            let mut hidden = with_precincts(0x11);
            hidden.splice(at..at, [&[0xff, 0x30][..], &length].concat());
            assert_eq!(check_styles(&hidden, size), lost);
        }
    }

    #[test]
    fn layers_and_code_blocks_are_counted_too() {
        let (bytes, _) = stream("bits08_unsigned");
        let at = bytes.windows(2).position(|w| w == [0xff, COD]).unwrap();
        let changed = |offset: usize, value: &[u8], size: Size| {
            let mut changed = bytes.clone();
            changed[at + offset..at + offset + value.len()].copy_from_slice(value);
            check_styles(&changed, size)
        };
        let size = Size { columns: 4096, rows: 4096 };
        // Behind marker and length: flags, progression, two bytes of layers, colours, levels, exponents of a block's sides less two.
        assert_eq!(changed(6, &[0, 20], size), Ok(true));
        assert_eq!(changed(10, &[4, 4], size), Ok(true));
        assert!(changed(10, &[0, 0], size).is_err());
        assert_eq!(changed(10, &[0, 0], SIZE), Ok(true));
    }

    #[test]
    fn sizes_are_checked_before_the_library_believes_them() {
        let (bytes, _) = stream("bits08_unsigned");
        let at = bytes.windows(4).position(|w| w == START).unwrap() + 4;
        let changed = |offset: usize, value: &[u8]| {
            let mut changed = bytes.clone();
            changed[at + offset..at + offset + value.len()].copy_from_slice(value);
            decode(&changed, SIZE).unwrap_err()
        };
        assert!(matches!(changed(4, &[0x7f; 4]), Fault::OtherSize { .. }));
        assert!(matches!(changed(20, &[0, 0, 0, 0]), Fault::Damaged(_)));
        assert!(matches!(changed(36, &[0, 3]), Fault::Unsupported(_)));
        assert!(matches!(changed(38, &[24]), Fault::Unsupported(_)));
    }
}
