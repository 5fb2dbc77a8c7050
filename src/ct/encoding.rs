//! How the pixels of an image are stored: where in its file, packed how, and with what loss. Pure.

use super::Warning;
use super::codec::Codec;
use super::series::Header;
use std::ops::Range;

/// Where the pixels of one image stand: an image is a frame of a file, most often the only one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Frame {
    /// Number of the frame from 1; `None` where the file holds a single image.
    pub(super) number: Option<usize>,
    /// Bytes that, joined, are its pixels: of the file, or of its data set where that is deflated.
    pub(super) pieces: Vec<Range<u64>>,
    /// Where in the file the deflated data set begins.
    pub(super) deflated_from: Option<u64>,
    /// Whether bytes were swapped in pairs though each is a pixel: 8 bits in big-endian words.
    pub(super) is_swapped: bool,
    /// Whether the pixels of all frames are more than the header's size needs, beyond a byte that makes them even.
    pub(super) is_too_long: bool,
}

/// How the pixels of a file are packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Packing {
    /// As they are, words little or big endian.
    Native { is_big_endian: bool },
    /// By one of the codecs.
    Compressed(Codec),
    /// In a way that is not known.
    Unknown,
}

/// A transfer syntax.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Syntax {
    /// For the operator.
    pub(super) name: &'static str,
    pub(super) packing: Packing,
    /// Whether it may or must lose something.
    pub(super) loss: SyntaxLoss,
}

/// What a transfer syntax does to pixel values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SyntaxLoss {
    Never,
    Possible,
    Always,
}

/// Where pixel values were lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Loss {
    Nowhere,
    /// By the transfer syntax of the file.
    HereAndNow,
    /// Before they were stored as they are.
    Before,
}

impl Loss {
    /// What a syntax and the attribute LossyImageCompression, where there is one, say together. The attribute may be wrong: what the
    /// pixels' own stream says is told once they are decoded.
    pub(super) const fn of(syntax: SyntaxLoss, said: Option<bool>) -> Self {
        match (syntax, said) {
            (SyntaxLoss::Always, _) | (SyntaxLoss::Possible, None | Some(true)) => Self::HereAndNow,
            (SyntaxLoss::Never, Some(true)) => Self::Before,
            _ => Self::Nowhere,
        }
    }
}

/// What loss does.
pub(super) const LOSS_CONSEQUENCE: &str = "values at the lumen's edge may be altered, so that its boundary is less certain; use the original where there is one";

/// Warnings about loss in the images of a series.
pub(super) fn warnings(images: &[Header]) -> Vec<Warning> {
    let with = |loss: Loss| images.iter().filter(move |h| h.loss == loss);
    let mut warnings = Vec::new();
    if let Some(first) = with(Loss::HereAndNow).next() {
        let n = with(Loss::HereAndNow).count();
        let text =
            format!("{n} image(s) are compressed with loss ({}): {LOSS_CONSEQUENCE}", first.syntax.name);
        warnings.push(Warning::new("ct.lossy", text));
    }
    let n_before = with(Loss::Before).count();
    if n_before > 0 {
        let text = format!(
            "{n_before} image(s) were compressed with loss before they were stored: {LOSS_CONSEQUENCE}"
        );
        warnings.push(Warning::new("ct.lossy_before", text));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::super::series::tests::header;
    use super::*;

    #[test]
    fn what_the_header_says_decides_where_a_syntax_leaves_it_open() {
        use SyntaxLoss::{Always, Never, Possible};
        let losses = |syntax| [None, Some(false), Some(true)].map(|said| Loss::of(syntax, said));
        assert_eq!(losses(Never), [Loss::Nowhere, Loss::Nowhere, Loss::Before]);
        assert_eq!(losses(Possible), [Loss::HereAndNow, Loss::Nowhere, Loss::HereAndNow]);
        assert_eq!(losses(Always), [Loss::HereAndNow; 3]);
    }

    #[test]
    fn warnings_count_the_images_and_name_the_syntax() {
        let mut images = [header("a", 0.0), header("b", 1.0), header("c", 2.0)];
        assert!(warnings(&images).is_empty());
        images[0].loss = Loss::HereAndNow;
        images[0].syntax.name = "JPEG-LS (near-lossless)";
        images[2].loss = Loss::Before;
        let found = warnings(&images);
        assert_eq!([found[0].code.as_str(), found[1].code.as_str()], ["ct.lossy", "ct.lossy_before"]);
        assert!(
            found[0]
                .text
                .starts_with("1 image(s) are compressed with loss (JPEG-LS (near-lossless)): values")
        );
    }
}
