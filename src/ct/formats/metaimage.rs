//! MetaImage headers (`.mha`, `.mhd`): lines `Key = Value` up to `ElementDataFile` (MetaIO, itk.org).
//!
//! Coordinates are LPS, as ITK writes them. The i-th triple of `TransformMatrix` is the direction of the i-th axis.

use super::grid::{Grid, spans_nothing};
use super::text::{Field, lines};
use super::values::{Endian, Packing, Scalar};
use super::{DataFile, DataPlace, Fault, Header, Skip, checked_sides};
use crate::ct::Warning;
use crate::geom::{Point3, Vector3};
use std::collections::BTreeMap;

const FORMAT: &str = "MetaImage";
/// Keys that a header begins with.
const FIRST_KEYS: [&str; 5] = ["ObjectType", "NDims", "Comment", "ObjectSubType", "TransformType"];

/// Whether the bytes begin as a header does.
pub(super) fn is_one(bytes: &[u8]) -> bool {
    let start = &bytes[..bytes.len().min(256)];
    let Some((first, _)) = lines(start).next() else { return false };
    split(&first).is_some_and(|(key, _)| FIRST_KEYS.contains(&key))
}

fn split(line: &str) -> Option<(&str, &str)> {
    line.split_once('=').map(|(key, value)| (key.trim(), value.trim()))
}

/// Reads a header.
pub(super) fn header(bytes: &[u8]) -> Result<Header, Fault> {
    let mut fields = BTreeMap::new();
    for (line, next) in lines(bytes) {
        let Some((key, value)) = split(&line) else { continue };
        if key == "ElementDataFile" {
            return Fields(fields).header(value, next);
        }
        fields.insert(key.to_owned(), value.to_owned());
    }
    Err(Fault::Missing { format: FORMAT, field: "ElementDataFile" })
}

fn unsupported(what: impl Into<String>, instead: &'static str) -> Fault {
    Fault::Unsupported { format: FORMAT, what: what.into(), instead }
}

struct Fields(BTreeMap<String, String>);

impl Fields {
    /// The first of several names of a field.
    fn any(&self, names: &[&'static str]) -> Option<Field<'_>> {
        let field = |name: &&'static str| self.0.get(*name).map(|text| Field { format: FORMAT, name, text });
        names.iter().find_map(field)
    }

    fn needed(&self, name: &'static str) -> Result<Field<'_>, Fault> {
        self.any(&[name]).ok_or(Fault::Missing { format: FORMAT, field: name })
    }

    fn flag(&self, names: &[&'static str]) -> bool {
        self.any(names).is_some_and(|f| f.text.starts_with(['T', 't', '1']))
    }

    fn header(&self, data_file: &str, next: usize) -> Result<Header, Fault> {
        let mut warnings = Vec::new();
        let sides = self.needed("DimSize")?.whole_numbers()?;
        let (dims, n_further) = checked_sides(FORMAT, "DimSize", &sides)?;
        let channels = self.any(&["ElementNumberOfChannels"]).map(|f| channels(&f)).transpose()?.unwrap_or(1);
        if channels > 1 && n_further > 1 {
            return Err(unsupported("channels in more than three dimensions", "write one of them a file"));
        }
        let is_msb = self.flag(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"]);
        let grid = self.grid(dims, sides.len(), &mut warnings)?;
        Ok(Header {
            format: FORMAT,
            grid,
            n_volumes: channels * n_further,
            is_interleaved: channels > 1,
            scalar: scalar(&self.needed("ElementType")?)?,
            endian: if is_msb { Endian::Big } else { Endian::Little },
            rescale: [1.0, 0.0],
            place: self.place(data_file, next)?,
            modality: self.any(&["Modality"]).and_then(|f| modality(f.text)),
            slab_thickness_mm: self.thickness()?,
            warnings,
        })
    }

    fn unit_mm(&self) -> Result<f64, Fault> {
        self.any(&["DistanceUnits"]).map_or(Ok(1.0), |f| match f.text {
            "mm" | "?" | "" => Ok(1.0),
            "um" => Ok(0.001),
            "cm" => Ok(10.0),
            _ => Err(f.fault("um, mm or cm")),
        })
    }

    /// N numbers, of more dimensions the first three.
    fn triple(&self, names: &[&'static str]) -> Result<Option<Vector3>, Fault> {
        let Some(field) = self.any(names) else { return Ok(None) };
        match field.numbers()?.as_slice() {
            [x, y, z, ..] => Ok(Some(Vector3::new(*x, *y, *z))),
            _ => Err(field.fault("three numbers")),
        }
    }

    fn thickness(&self) -> Result<Option<f64>, Fault> {
        let size = self.triple(&["ElementSize"])?.map(|s| s.z * self.unit_mm().unwrap_or(1.0));
        Ok(size.filter(|&t| t > 0.0 && t.is_finite()))
    }

    fn grid(&self, dims: [usize; 3], n_dims: usize, warnings: &mut Vec<Warning>) -> Result<Grid, Fault> {
        let unit_mm = self.unit_mm()?;
        let spacing = self.triple(&["ElementSpacing", "ElementSize"])?;
        let spacing = spacing.ok_or(Fault::Missing { format: FORMAT, field: "ElementSpacing" })? * unit_mm;
        let origin = self.triple(&["Offset", "Position", "Origin"])?.unwrap_or_default() * unit_mm;
        let matrix = self.any(&["TransformMatrix", "Rotation", "Orientation"]);
        let directions = match matrix {
            Some(field) => directions(&field, n_dims)?,
            None => {
                let text = "the file does not state how the volume lies in the patient; columns were taken to run left, rows to the back, planes up";
                warnings.push(Warning::new("ct.no_orientation", text));
                [Vector3::x(), Vector3::y(), Vector3::z()]
            }
        };
        let axes_mm = [directions[0] * spacing.x, directions[1] * spacing.y, directions[2] * spacing.z];
        let grid = Grid { dims, origin: Point3::from(origin), axes_mm };
        let odd = spans_nothing(FORMAT, "its axes", "directions and distances of three axes");
        if grid.is_sound() { Ok(grid) } else { Err(odd) }
    }

    fn place(&self, data_file: &str, next: usize) -> Result<DataPlace, Fault> {
        let is_local = data_file.eq_ignore_ascii_case("LOCAL");
        if data_file.starts_with("LIST") || data_file.contains('%') {
            return Err(unsupported("its values in several files", "write them into one file"));
        }
        if data_file.is_empty() {
            return Err(Fault::Missing { format: FORMAT, field: "ElementDataFile" });
        }
        let is_text = self.any(&["BinaryData"]).is_some_and(|f| f.text.starts_with(['F', 'f', '0']));
        let packing = match (is_text, self.flag(&["CompressedData"])) {
            (true, _) => Packing::Text,
            (false, true) => Packing::Zlib,
            (false, false) => Packing::Raw,
        };
        let header_size = self.any(&["HeaderSize"]).map(|f| header_size(&f)).transpose()?.unwrap_or(Some(0));
        let skip = match (is_local, header_size) {
            (true, _) => Skip::File(next),
            (false, Some(n)) => Skip::File(n),
            (false, None) if packing == Packing::Raw => Skip::AllButValues,
            (false, None) => {
                return Err(unsupported("HeaderSize -1 and packed values", "state the header's size"));
            }
        };
        let file = (!is_local).then(|| DataFile::Named(data_file.to_owned()));
        Ok(DataPlace { file, packing, skip })
    }
}

/// Bytes before the values; `None`: as many as there are.
fn header_size(field: &Field<'_>) -> Result<Option<usize>, Fault> {
    match field.whole_numbers()?.as_slice() {
        [-1] => Ok(None),
        [n] => usize::try_from(*n).map(Some).or(Err(field.fault("a number of bytes, or -1"))),
        _ => Err(field.fault("a number of bytes, or -1")),
    }
}

fn channels(field: &Field<'_>) -> Result<usize, Fault> {
    match field.whole_numbers()?.as_slice() {
        [n @ 1..=1024] => Ok(usize::try_from(*n).unwrap_or(1)),
        _ => Err(field.fault("a number from 1 to 1024")),
    }
}

/// Unit vectors of the three axes in the patient.
fn directions(field: &Field<'_>, n_dims: usize) -> Result<[Vector3; 3], Fault> {
    let numbers = field.numbers()?;
    if numbers.len() != n_dims * n_dims {
        return Err(field.fault("as many rows of as many numbers as there are dimensions"));
    }
    Ok([0, 1, 2].map(|axis| Vector3::from_fn(|i, _| numbers[axis * n_dims + i])))
}

fn scalar(field: &Field<'_>) -> Result<Scalar, Fault> {
    let name = field.text.strip_suffix("_ARRAY").unwrap_or(field.text);
    Ok(match name {
        "MET_CHAR" | "MET_ASCII_CHAR" => Scalar::I8,
        "MET_UCHAR" => Scalar::U8,
        "MET_SHORT" => Scalar::I16,
        "MET_USHORT" => Scalar::U16,
        "MET_INT" | "MET_LONG" => Scalar::I32,
        "MET_UINT" | "MET_ULONG" => Scalar::U32,
        "MET_LONG_LONG" => Scalar::I64,
        "MET_ULONG_LONG" => Scalar::U64,
        "MET_FLOAT" => Scalar::F32,
        "MET_DOUBLE" => Scalar::F64,
        _ => return Err(field.fault("MET_CHAR to MET_DOUBLE")),
    })
}

fn modality(text: &str) -> Option<&'static str> {
    Some(match text {
        "MET_MOD_CT" => "CT",
        "MET_MOD_MR" => "MR",
        "MET_MOD_NM" => "NM",
        "MET_MOD_US" => "US",
        _ => return None,
    })
}
