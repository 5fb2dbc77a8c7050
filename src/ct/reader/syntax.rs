//! Transfer syntaxes: what each is called, how it packs pixels, and whether it loses something.

use super::super::codec::Codec;
use super::super::encoding::{Packing, Syntax, SyntaxLoss};
use super::super::series::PixelFormat;
use dicom_dictionary_std::uids;

/// Explicit VR big endian: retired, but archives still hold such files.
pub(in crate::ct) const EXPLICIT_BIG_ENDIAN_UID: &str = "1.2.840.10008.1.2.2";

const LITTLE: Packing = Packing::Native { is_big_endian: false };
const BIG: Packing = Packing::Native { is_big_endian: true };
const RLE: Packing = Packing::Compressed(Codec::Rle { bytes_per_pixel: 2 });
const JPEG: Packing = Packing::Compressed(Codec::Jpeg);
const JPEG_LS: Packing = Packing::Compressed(Codec::JpegLs);
const JPEG_2000: Packing = Packing::Compressed(Codec::Jpeg2000);

/// The syntaxes that occur, by UID.
const SYNTAXES: [(&str, &str, Packing, SyntaxLoss); 17] = {
    use SyntaxLoss::{Always, Never, Possible};
    [
        (uids::IMPLICIT_VR_LITTLE_ENDIAN, "implicit VR little endian", LITTLE, Never),
        (uids::EXPLICIT_VR_LITTLE_ENDIAN, "explicit VR little endian", LITTLE, Never),
        (EXPLICIT_BIG_ENDIAN_UID, "explicit VR big endian", BIG, Never),
        (uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN, "deflated explicit VR little endian", LITTLE, Never),
        (
            uids::ENCAPSULATED_UNCOMPRESSED_EXPLICIT_VR_LITTLE_ENDIAN,
            "encapsulated uncompressed",
            LITTLE,
            Never,
        ),
        (uids::RLE_LOSSLESS, "RLE", RLE, Never),
        (uids::JPEG_BASELINE8_BIT, "JPEG baseline (lossy)", JPEG, Always),
        (uids::JPEG_EXTENDED12_BIT, "JPEG extended 12 bit (lossy)", JPEG, Always),
        (uids::JPEG_LOSSLESS, "JPEG lossless", JPEG, Never),
        (uids::JPEG_LOSSLESS_SV1, "JPEG lossless, first-order", JPEG, Never),
        (uids::JPEGLS_LOSSLESS, "JPEG-LS", JPEG_LS, Never),
        (uids::JPEGLS_NEAR_LOSSLESS, "JPEG-LS (near-lossless)", JPEG_LS, Possible),
        (uids::JPEG2000_LOSSLESS, "JPEG 2000 lossless", JPEG_2000, Never),
        (uids::JPEG2000, "JPEG 2000", JPEG_2000, Possible),
        (uids::HTJ2K_LOSSLESS, "high-throughput JPEG 2000 lossless", JPEG_2000, Never),
        (uids::HTJ2K_LOSSLESS_RPCL, "high-throughput JPEG 2000 lossless, by resolution", JPEG_2000, Never),
        (uids::HTJ2K, "high-throughput JPEG 2000", JPEG_2000, Possible),
    ]
};

/// The syntax of that UID, for pixels of that format.
pub(super) fn syntax_of(uid: &str, pixels: PixelFormat) -> Syntax {
    const UNKNOWN: Syntax =
        Syntax { name: "an unknown transfer syntax", packing: Packing::Unknown, loss: SyntaxLoss::Possible };
    let uid = uid.trim_end_matches(['\0', ' ']);
    let known = SYNTAXES.into_iter().find(|s| s.0 == uid);
    let Some((_, name, packing, loss)) = known else { return UNKNOWN };
    let packing = match packing {
        RLE => Packing::Compressed(Codec::Rle { bytes_per_pixel: usize::from(pixels.bits_allocated / 8) }),
        other => other,
    };
    Syntax { name, packing, loss }
}
