//! JPEG 2000 by the `jpeg2k` library, whose decoder is a translation of OpenJPEG to Rust.
//!
//! It believes what a stream says of its size, and panics on some damaged ones: so the size segment (ITU-T T.800 A.5.1) is
//! read here first, and panics are caught. A stream that ends early is refused, not filled up.

use super::{Fault, Samples, Size, panics_caught};
use jpeg2k::{DecodeParameters, Image, ImageComponent};

/// Start of codestream and the size segment, which must come first.
const START: [u8; 4] = [0xff, 0x4f, 0xff, 0x51];
/// How far into a file with boxes around it the codestream may begin.
const LONGEST_BOXES: usize = 4096;
/// More tiles than this make no image: memory is set aside for each.
const MOST_TILES: u32 = 4096;

/// Decodes one image.
pub(super) fn decode(bytes: &[u8], size: Size) -> Result<Samples, Fault> {
    check_size(bytes, size)?;
    let strict = DecodeParameters::new().strict(true);
    let image = panics_caught(|| Image::from_bytes_with(bytes, strict));
    let Some(Ok(image)) = image else {
        return Err(Fault::Damaged("the JPEG 2000 pixels cannot be decoded"));
    };
    match image.components() {
        [component] => samples(component, size),
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
    Ok(Samples { words, precision_bits: component.precision(), is_signed: component.is_signed() })
}

/// Checks what the stream says before a decoder believes it.
fn check_size(bytes: &[u8], expected: Size) -> Result<(), Fault> {
    let head = &bytes[..bytes.len().min(LONGEST_BOXES)];
    let at = head.windows(4).position(|w| w == START);
    let at = at.ok_or(Fault::Damaged("the compressed pixels hold no JPEG 2000 codestream"))?;
    let segment = bytes.get(at + 4..at + 45).ok_or(Fault::Truncated)?;
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
