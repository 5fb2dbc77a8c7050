//! Why an image file cannot be used. One line each: what was found, what was expected, what to do.

/// What is wrong with an image file that is no DICOM.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Fault {
    /// A header without something that is needed.
    #[error("its {format} header does not state {field}: write the file again")]
    Missing {
        /// The format.
        format: &'static str,
        /// The field.
        field: &'static str,
    },
    /// A header with something senseless.
    #[error("its {format} header states {field} as {found}, expected {expected}: write the file again")]
    Field {
        /// The format.
        format: &'static str,
        /// The field.
        field: &'static str,
        /// What stands there.
        found: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// A header that breaks off.
    #[error("its {format} header breaks off after {found_bytes} bytes: copy or export the file again")]
    HeaderTruncated {
        /// The format.
        format: &'static str,
        /// Bytes present.
        found_bytes: usize,
    },
    /// Something that is not read.
    #[error("{format} with {what} is not read: {instead}")]
    Unsupported {
        /// The format.
        format: &'static str,
        /// What it is.
        what: String,
        /// What to do.
        instead: &'static str,
    },
    /// Values in a file that is not beside the header.
    #[error(
        "its {format} header names a file of values elsewhere, or what is no file: put the values beside the header and name them alone"
    )]
    ValuesElsewhere {
        /// The format.
        format: &'static str,
    },
    /// Less than the header declares.
    #[error(
        "truncated: its header declares {expected_bytes} bytes of values, there are {found_bytes}: copy or export the file again"
    )]
    Truncated {
        /// Bytes present.
        found_bytes: u64,
        /// Bytes declared.
        expected_bytes: u64,
    },
    /// Fewer numbers in text than the header declares.
    #[error(
        "truncated: its header declares {expected} values, there are {found}: copy or export the file again"
    )]
    TooFewValues {
        /// Numbers present.
        found: usize,
        /// Numbers declared.
        expected: usize,
    },
    /// Packed bytes that cannot hold what the header declares.
    #[error(
        "truncated: its header declares {expected_bytes} bytes of values, more than {packed_bytes} {packing} bytes can hold: copy or export the file again"
    )]
    PackedTooShort {
        /// Bytes present.
        packed_bytes: usize,
        /// Their packing.
        packing: &'static str,
        /// Bytes declared.
        expected_bytes: u64,
    },
    /// Packed bytes that cannot be unpacked.
    #[error("damaged: its {packing} values cannot be unpacked: copy or export the file again")]
    Damaged {
        /// Their packing.
        packing: &'static str,
    },
    /// A value in text that is no number.
    #[error("damaged: value number {index} is no number: write the file again")]
    NotANumber {
        /// Its place among the values, from 0.
        index: usize,
    },
    /// Axes that are not at right angles.
    #[error(
        "its axes are {angle_deg:.2} degrees off right angles, a sheared grid (gantry tilt?): resample it to right angles"
    )]
    Sheared {
        /// The most that a right angle is missed by.
        angle_deg: f64,
    },
    /// The volume does not fit into memory.
    #[error("the volume of {} x {} x {} voxels is too large for this machine's memory: crop it", dims[0], dims[1], dims[2])]
    TooLarge {
        /// Columns, rows, planes.
        dims: [usize; 3],
    },
    /// A label map with something else than labels.
    #[error(
        "voxel {index} has the value {found}, expected a whole number from 0 to 4294967295: a label map is needed, not an image"
    )]
    NotALabel {
        /// Its place among the values, from 0.
        index: usize,
        /// The value.
        found: f64,
    },
    /// Labels in the place of intensities.
    #[error(
        "it holds even patches of whole numbers from 0 to {most}, a label map and no image: give it with --segmentation, and with --ct the image that it was drawn on"
    )]
    LabelMap {
        /// The largest label.
        most: f32,
    },
    /// The work was interrupted.
    #[error(transparent)]
    Cancelled(#[from] crate::progress::Cancelled),
}

impl Fault {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Missing { .. } => "ct.image_missing",
            Self::Field { .. } => "ct.image_field",
            Self::HeaderTruncated { .. } => "ct.image_header_truncated",
            Self::Unsupported { .. } => "ct.image_unsupported",
            Self::ValuesElsewhere { .. } => "ct.image_values_elsewhere",
            Self::Truncated { .. } => "ct.image_truncated",
            Self::TooFewValues { .. } => "ct.image_too_few_values",
            Self::PackedTooShort { .. } => "ct.image_packed_too_short",
            Self::Damaged { .. } => "ct.image_damaged",
            Self::NotANumber { .. } => "ct.image_not_a_number",
            Self::Sheared { .. } => "ct.image_sheared",
            Self::TooLarge { .. } => "ct.image_too_large",
            Self::NotALabel { .. } => "ct.not_a_label",
            Self::LabelMap { .. } => "ct.label_map",
            Self::Cancelled(_) => "ct.cancelled",
        }
    }
}
