//! Damaged and odd DICOM input: one fault a series, and exactly what is said about it.
//!
//! Every row takes a sound series of eight planes and does one thing to it. What it then says is compared word for
//! word (paths as names below the folder), by reading and by inspecting: a series that cannot be read must be unusable, and one that
//! can must not be. Segmentations (SEG, RTSTRUCT) have a table of their own (`segmentations`). Nothing may panic, and no length that a header claims may be believed before it is checked.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

mod attributes;
mod files;
mod folder;
mod geometry;
mod media;
mod segmentations;
