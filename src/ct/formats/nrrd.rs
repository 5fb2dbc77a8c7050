//! NRRD headers (`.nrrd`, `.nhdr`): lines `field: value` up to an empty one (teem.sourceforge.net/nrrd/format.html).
//!
//! Directions and origin are in the stated space and become LPS here. One axis may be none of space: time, or a list of components,
//! before or after the others.

use super::grid::{Grid, spans_nothing};
use super::text::{Field, lines};
use super::values::{Endian, Packing, Scalar};
use super::{DataFile, DataPlace, Fault, Header, Skip, checked_sides};
use crate::ct::Warning;
use crate::geom::{Point3, Vector3};
use std::collections::BTreeMap;

const FORMAT: &str = "NRRD";

/// Whether the bytes begin as a header does.
pub(super) fn is_one(bytes: &[u8]) -> bool {
    bytes.starts_with(b"NRRD000")
}

/// Reads a header.
pub(super) fn header(bytes: &[u8]) -> Result<Header, Fault> {
    let mut fields = BTreeMap::new();
    let mut end = bytes.len();
    for (line, next) in lines(bytes).skip(1) {
        if line.is_empty() {
            end = next;
            break;
        }
        // `key:=value` is free text, which nothing depends on.
        let Some((name, value)) = line.split_once(':').filter(|(_, v)| !v.starts_with('=')) else { continue };
        if !line.starts_with('#') {
            let name: String = name.to_ascii_lowercase().split_whitespace().collect();
            fields.insert(name, value.trim().to_owned());
        }
    }
    Fields(fields).header(end)
}

fn unsupported(what: impl Into<String>, instead: &'static str) -> Fault {
    Fault::Unsupported { format: FORMAT, what: what.into(), instead }
}

/// Fields by their names without blanks.
struct Fields(BTreeMap<String, String>);

/// Which axes of the array are the volume's.
struct Axes {
    dims: [usize; 3],
    n_volumes: usize,
    /// Index of the first axis of space.
    first: usize,
}

impl Fields {
    fn field(&self, name: &'static str) -> Option<Field<'_>> {
        let compact: String = name.split_whitespace().collect();
        self.0.get(&compact).map(|text| Field { format: FORMAT, name, text })
    }

    fn needed(&self, name: &'static str) -> Result<Field<'_>, Fault> {
        self.field(name).ok_or(Fault::Missing { format: FORMAT, field: name })
    }

    fn header(&self, end: usize) -> Result<Header, Fault> {
        let mut warnings = Vec::new();
        let axes = self.axes()?;
        let scalar = scalar(&self.needed("type")?)?;
        let place = self.place(end)?;
        let endian = self.endian(scalar, place.packing)?;
        let grid = self.grid(&axes, &mut warnings)?;
        Ok(Header {
            format: FORMAT,
            grid,
            n_volumes: axes.n_volumes,
            is_interleaved: axes.first > 0 && axes.n_volumes > 1,
            scalar,
            endian,
            rescale: [1.0, 0.0],
            place,
            modality: None,
            slab_thickness_mm: self.thickness(&axes),
            warnings,
        })
    }

    fn endian(&self, scalar: Scalar, packing: Packing) -> Result<Endian, Fault> {
        match self.field("endian") {
            Some(f) => match f.text.to_ascii_lowercase().as_str() {
                "little" => Ok(Endian::Little),
                "big" => Ok(Endian::Big),
                _ => Err(f.fault("little or big")),
            },
            None if scalar.n_bytes() == 1 || packing == Packing::Text => Ok(Endian::Little),
            None => Err(Fault::Missing { format: FORMAT, field: "endian" }),
        }
    }

    fn axes(&self) -> Result<Axes, Fault> {
        let sizes = self.needed("sizes")?;
        let sides = sizes.whole_numbers()?;
        let first = self.first_axis_of_space(sides.len())?;
        if sides.len() > 4 {
            return Err(sizes.fault("three or four sizes"));
        }
        // Of four axes the one that is none of space counts the volumes, wherever it stands.
        let mut ordered = sides.clone();
        ordered.rotate_left(first);
        let (dims, n_volumes) = checked_sides(FORMAT, "sizes", &ordered)?;
        Ok(Axes { dims, n_volumes, first })
    }

    fn first_axis_of_space(&self, n_axes: usize) -> Result<usize, Fault> {
        if n_axes != 4 {
            return Ok(0);
        }
        let places = |f: &Field<'_>, is_space: fn(&str) -> bool| -> Vec<bool> {
            tokens(f.text).iter().map(|t| is_space(t)).collect()
        };
        let of_directions = self.field("space directions").map(|f| (f, places(&f, |t| t != "none")));
        let of_kinds = || self.field("kinds").map(|f| (f, places(&f, |t| matches!(t, "domain" | "space"))));
        let Some((field, are_space)) = of_directions.or_else(of_kinds) else { return Ok(0) };
        match are_space.as_slice() {
            [false, true, true, true] => Ok(1),
            [true, true, true, _] => Ok(0),
            _ => Err(field.fault("an entry for each of the four axes, three of space side by side")),
        }
    }

    fn grid(&self, axes: &Axes, warnings: &mut Vec<Warning>) -> Result<Grid, Fault> {
        let flips = self.flips(warnings)?;
        let (mut origin, mut axes_mm) = match self.field("space directions") {
            Some(field) => {
                let origin = self.field("space origin").map(|f| vector(&f, f.text)).transpose()?;
                (origin.unwrap_or_default(), self.directions(&field, axes)?)
            }
            None => self.spacings(axes)?,
        };
        let unit_mm = self.unit_mm()?;
        for v in axes_mm.iter_mut().chain([&mut origin]) {
            *v = v.component_mul(&flips) * unit_mm;
        }
        let grid = Grid { dims: axes.dims, origin: Point3::from(origin), axes_mm };
        let odd = spans_nothing(FORMAT, "its axes", "directions and distances of three axes");
        if grid.is_sound() { Ok(grid) } else { Err(odd) }
    }

    /// Signs that turn the stated space into LPS.
    fn flips(&self, warnings: &mut Vec<Warning>) -> Result<Vector3, Fault> {
        let Some(field) = self.field("space").filter(|_| self.field("space directions").is_some()) else {
            warnings.push(no_orientation("the file does not state how the volume lies in the patient"));
            return Ok(Vector3::new(1.0, 1.0, 1.0));
        };
        let name = field.text.to_ascii_lowercase();
        match name.strip_suffix("-time").unwrap_or(&name) {
            "left-posterior-superior" | "lps" => Ok(Vector3::new(1.0, 1.0, 1.0)),
            "right-anterior-superior" | "ras" => Ok(Vector3::new(-1.0, -1.0, 1.0)),
            "left-anterior-superior" | "las" => Ok(Vector3::new(1.0, -1.0, 1.0)),
            "3d-left-handed" => Err(field.fault(
                "a right-handed space (left-posterior-superior, right-anterior-superior, 3D-right-handed): a left-handed one shows the vessel mirrored",
            )),
            "scanner-xyz" | "3d-right-handed" => {
                warnings.push(no_orientation("the file's space is not the patient's"));
                Ok(Vector3::new(1.0, 1.0, 1.0))
            }
            _ => Err(field.fault("a space of the format")),
        }
    }

    fn unit_mm(&self) -> Result<f64, Fault> {
        let Some(field) = self.field("space units") else { return Ok(1.0) };
        let units: Vec<&str> = field.text.split('"').filter(|u| !u.trim().is_empty()).collect();
        match units.first().map(|u| (*u, units[..units.len().min(3)].iter().all(|other| other == u))) {
            Some(("mm" | "millimeter" | "???" | "", true)) | None => Ok(1.0),
            Some(("cm", true)) => Ok(10.0),
            Some(("m", true)) => Ok(1000.0),
            Some(("um" | "micron", true)) => Ok(0.001),
            Some(_) => Err(field.fault("um, mm, cm or m, the same for all axes")),
        }
    }

    fn directions(&self, field: &Field<'_>, axes: &Axes) -> Result<[Vector3; 3], Fault> {
        let tokens = tokens(field.text);
        let mut directions = [Vector3::zeros(); 3];
        for (i, direction) in directions.iter_mut().enumerate() {
            let token = tokens.get(axes.first + i).ok_or_else(|| field.fault("a direction for each axis"))?;
            *direction = vector(field, token)?;
        }
        Ok(directions)
    }

    /// Distances alone, and where the first voxel lies on each axis.
    fn spacings(&self, axes: &Axes) -> Result<(Vector3, [Vector3; 3]), Fault> {
        let per_axis = |name: &'static str| -> Result<Option<Vector3>, Fault> {
            let Some(field) = self.field(name) else { return Ok(None) };
            let numbers: Option<Vec<f64>> = field.text.split_whitespace().map(|t| t.parse().ok()).collect();
            let numbers = numbers.unwrap_or_default();
            let of = numbers.get(axes.first..axes.first + 3);
            Ok(Some(of.map(Vector3::from_row_slice).ok_or_else(|| field.fault("a number for each axis"))?))
        };
        let spacing = per_axis("spacings")?.ok_or(Fault::Missing { format: FORMAT, field: "spacings" })?;
        let mins = per_axis("axis mins")?.filter(|m| m.iter().all(|v| v.is_finite())).unwrap_or_default();
        // An axis of cells begins at its first cell's border, not at its middle.
        let is_cell = |axis: usize| {
            let kinds = self.field("centers").or_else(|| self.field("centerings"));
            kinds.is_some_and(|f| f.text.split_whitespace().nth(axes.first + axis) == Some("cell"))
        };
        let has_mins = self.field("axis mins").is_some();
        let start = |axis: usize| if has_mins && is_cell(axis) { 0.5 * spacing[axis] } else { 0.0 };
        let origin = Vector3::from_fn(|axis, _| mins[axis] + start(axis));
        Ok((origin, [Vector3::x() * spacing.x, Vector3::y() * spacing.y, Vector3::z() * spacing.z]))
    }

    fn thickness(&self, axes: &Axes) -> Option<f64> {
        let word = self.field("thicknesses")?.text.split_whitespace().nth(axes.first + 2)?;
        word.parse().ok().filter(|t: &f64| *t > 0.0 && t.is_finite())
    }

    fn place(&self, end: usize) -> Result<DataPlace, Fault> {
        let encoding = self.needed("encoding")?;
        let packing = match encoding.text.to_ascii_lowercase().as_str() {
            "raw" => Packing::Raw,
            "gzip" | "gz" => Packing::Gzip,
            "txt" | "text" | "ascii" => Packing::Text,
            "hex" | "bzip2" | "bz2" => {
                return Err(unsupported(format!("encoding {}", encoding.text), "write it raw or gzip"));
            }
            _ => return Err(encoding.fault("raw, gzip or ascii")),
        };
        let file = self.field("data file").or_else(|| self.field("datafile"));
        if file.is_some_and(|f| f.text.starts_with("LIST") || f.text.contains('%')) {
            return Err(unsupported("its values in several files", "write them into one file"));
        }
        let count = |name: &'static str| self.field(name).map(|f| count(&f)).transpose();
        let n_lines = count("line skip")?.flatten().unwrap_or(0);
        let start = if file.is_some() { 0 } else { end };
        let skip = match (count("byte skip")?, packing) {
            (Some(None), Packing::Raw) => Skip::AllButValues,
            (Some(None), _) => {
                return Err(unsupported("byte skip -1 and packed values", "state the number of bytes"));
            }
            (Some(Some(n)), _) if n > 0 && packing == Packing::Gzip => {
                return Err(unsupported("bytes to skip and packed values", "write it without byte skip"));
            }
            (bytes, _) => Skip::Lines { start, n_lines, n_bytes: bytes.flatten().unwrap_or(0) },
        };
        let file = file.map(|f| DataFile::Named(f.text.to_owned()));
        Ok(DataPlace { file, packing, skip })
    }
}

fn no_orientation(what: &str) -> Warning {
    let text = format!("{what}; columns were taken to run left, rows to the back, planes up");
    Warning::new("ct.no_orientation", text)
}

/// A number from 0; `None` for -1.
fn count(field: &Field<'_>) -> Result<Option<usize>, Fault> {
    match field.whole_numbers()?.as_slice() {
        [-1] => Ok(None),
        [n @ 0..=1_000_000_000] => Ok(usize::try_from(*n).ok()),
        _ => Err(field.fault("a number from -1 to 1000000000")),
    }
}

/// Words and vectors in brackets.
fn tokens(text: &str) -> Vec<&str> {
    let mut tokens = Vec::new();
    let mut rest = text.trim_start();
    while !rest.is_empty() {
        let end = match rest.find(')') {
            Some(close) if rest.starts_with('(') => close + 1,
            _ => rest.find(char::is_whitespace).unwrap_or(rest.len()),
        };
        tokens.push(&rest[..end]);
        rest = rest[end..].trim_start();
    }
    tokens
}

fn vector(field: &Field<'_>, token: &str) -> Result<Vector3, Fault> {
    let inner = token.trim().strip_prefix('(').and_then(|t| t.strip_suffix(')'));
    let numbers: Option<Vec<f64>> =
        inner.map(|t| t.split(',').map(|n| n.trim().parse().ok()).collect()).unwrap_or_default();
    match numbers.as_deref() {
        Some([x, y, z]) if [x, y, z].into_iter().all(|v| v.is_finite()) => Ok(Vector3::new(*x, *y, *z)),
        _ => Err(field.fault("vectors (x,y,z) of finite numbers")),
    }
}

fn scalar(field: &Field<'_>) -> Result<Scalar, Fault> {
    let words: String = field.text.to_ascii_lowercase().split_whitespace().collect::<Vec<_>>().join(" ");
    Ok(match words.as_str() {
        "signed char" | "int8" | "int8_t" => Scalar::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Scalar::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Scalar::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Scalar::U16,
        "int" | "signed int" | "int32" | "int32_t" => Scalar::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Scalar::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => Scalar::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Scalar::U64,
        "float" => Scalar::F32,
        "double" => Scalar::F64,
        _ => return Err(field.fault("an integer or floating-point type")),
    })
}
