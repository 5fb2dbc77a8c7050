//! 3MF (*3D Manufacturing Format, Core Specification*, 1.3): the triangles of everything that is to be built.
//!
//! The package's relationships name the model part. Its objects are meshes, or put together of others; its build items say
//! which of them are wanted and where. Transforms are applied and units converted to mm.
//!
//! Items that are marked as not to be printed (`printable="0"`, as slicers write it), and objects that are no part of the model
//! (supports and surfaces, by their type) are left out, and told.
//!
//! What it does not do: parts besides the model (*Production Extension*), materials, slices, beam lattices, what is said
//! about printing; none of it changes the surfaces, but for the first, which is refused, as is every other extension that the
//! model says it needs.

use super::package::{self, PackageError};
use super::{Contents, Facet};
use crate::ct::Warning;
use quick_xml::events::{BytesStart, Event};
use std::collections::{BTreeMap, BTreeSet};

const RELATIONSHIPS: &str = "_rels/.rels";
const MODEL_TYPE: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel";
/// Objects in each other, at most: deeper ones go round in circles.
const DEEPEST: usize = 32;
/// Triangles and objects, at most, as they stand in the file and as components multiply them.
const MOST_TRIANGLES: usize = 20_000_000;
const MOST_OBJECTS: usize = 1_000_000;

/// Extensions that leave the surfaces as they are: materials, slices, and parts of their own, which are refused where there are any.
const HARMLESS: [&str; 3] =
    ["/3dmanufacturing/material/", "/3dmanufacturing/slice/", "/3dmanufacturing/production/"];

/// The bytes are no 3MF that can be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ThreeMfError {
    /// The package.
    #[error("it is no 3MF: {0}: export the model again")]
    Package(#[from] PackageError),
    /// A part is missing.
    #[error("it is no 3MF: the package holds no {0}: export the model again")]
    Missing(&'static str),
    /// A part is no XML.
    #[error("byte {at} of the model: {fault}: export the model again")]
    Xml {
        /// The place in the part, bytes from its beginning.
        at: u64,
        /// What is wrong.
        fault: String,
    },
    /// An attribute is missing or senseless.
    #[error(
        "{element} near byte {at} of the model: found {attribute} {found:?}, expected {expected}: export the model again"
    )]
    Attribute {
        /// The place in the part, bytes from its beginning.
        at: u64,
        /// The element.
        element: &'static str,
        /// Its attribute.
        attribute: &'static str,
        /// What it says; empty where it is missing.
        found: String,
        /// What it should say.
        expected: &'static str,
    },
    /// A triangle names a vertex that is not there.
    #[error("object {object}: a triangle names vertex {vertex} of {n_vertices}: export the model again")]
    Vertex {
        /// The object's number.
        object: u32,
        /// The vertex, counted from 0.
        vertex: u32,
        /// Vertices of the object.
        n_vertices: usize,
    },
    /// A number without an object.
    #[error(
        "object {0} is to be built but not there, part of itself, or more than {DEEPEST} objects deep: export the model again"
    )]
    Object(u32),
    /// All of it was left out.
    #[error(
        "nothing in it is to be printed: its objects are marked as not printable, or are supports or surfaces: change that in \
         the program that made it, and export it again"
    )]
    NothingToPrint,
    /// It holds objects, but does not say where.
    #[error(
        "its build section places none of its objects, so nothing is to be printed: put them on the plate, and export it again"
    )]
    NothingPlaced,
    /// Parts of the production extension.
    #[error("it keeps objects in parts of their own: export it as plain 3MF or as STL")]
    OtherPart,
    /// What may change shapes in a way that is not known here.
    #[error("it needs the extension {0:?}, which may change its shapes: export it as plain 3MF or as STL")]
    Extension(String),
    /// Too much, or components that multiply beyond all bounds.
    #[error("it has more than {MOST_TRIANGLES} triangles or {MOST_OBJECTS} objects: reduce the mesh")]
    TooLarge,
}

/// Whether the bytes begin as a package does.
#[must_use]
pub fn is_package(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04")
}

/// The triangles of all build items, mm, and what was left out of them.
///
/// # Errors
/// [`ThreeMfError`].
pub fn read(bytes: &[u8]) -> Result<Contents, ThreeMfError> {
    let relationships =
        package::part(bytes, RELATIONSHIPS)?.ok_or(ThreeMfError::Missing("relationships (_rels/.rels)"))?;
    let path = model_path(&relationships)?.ok_or(ThreeMfError::Missing("relationship to a 3D model"))?;
    let part = package::part(bytes, &path)?.ok_or(ThreeMfError::Missing("3D model"))?;
    let document = Document::of(&part)?;
    let mut built = Built::default();
    let scaled = Transform::scaled(document.unit_mm);
    for (object, placed) in &document.items {
        document.place(*object, placed.then(&scaled), DEEPEST, &mut built)?;
    }
    let warnings: Vec<Warning> = [document.not_printable(), built.no_part()].into_iter().flatten().collect();
    if built.facets.is_empty() && !warnings.is_empty() {
        return Err(ThreeMfError::NothingToPrint);
    }
    if document.items.is_empty() {
        return Err(ThreeMfError::NothingPlaced);
    }
    Ok(Contents { facets: built.facets, warnings })
}

fn model_path(part: &[u8]) -> Result<Option<String>, ThreeMfError> {
    let mut found = None;
    elements(part, |element, at| {
        if let Tag::Start(start) = element
            && start.local_name().as_ref() == b"Relationship"
        {
            let element = Element { start, name: "Relationship", at };
            if element.text("Type")?.is_some_and(|kind| kind == MODEL_TYPE) {
                found = element.text("Target")?;
            }
        }
        Ok(())
    })?;
    Ok(found)
}

/// A tag of a part.
enum Tag<'a> {
    Start(&'a BytesStart<'a>),
    End(&'a [u8]),
}

/// Visits the tags of a part in order; an empty element has both of its own.
fn elements(
    part: &[u8],
    mut visit: impl FnMut(Tag<'_>, u64) -> Result<(), ThreeMfError>,
) -> Result<(), ThreeMfError> {
    let mut reader = quick_xml::Reader::from_reader(part);
    loop {
        let at = reader.buffer_position();
        match reader.read_event() {
            Ok(Event::Eof) => return Ok(()),
            Ok(Event::Start(start)) => visit(Tag::Start(&start), at)?,
            Ok(Event::Empty(start)) => {
                visit(Tag::Start(&start), at)?;
                visit(Tag::End(start.local_name().as_ref()), at)?;
            }
            Ok(Event::End(end)) => visit(Tag::End(end.local_name().as_ref()), at)?,
            Ok(_) => {}
            Err(fault) => {
                return Err(ThreeMfError::Xml { at: reader.error_position(), fault: fault.to_string() });
            }
        }
    }
}

/// An element whose attributes are asked for.
struct Element<'a> {
    start: &'a BytesStart<'a>,
    name: &'static str,
    at: u64,
}

impl Element<'_> {
    /// An attribute, by its name without that of its space.
    fn text(&self, attribute: &str) -> Result<Option<String>, ThreeMfError> {
        // Whether an attribute comes twice is not asked: of many it would take for ever.
        for found in self.start.attributes().with_checks(false) {
            let fault = |fault: String| ThreeMfError::Xml { at: self.at, fault };
            let found = found.map_err(|e| fault(e.to_string()))?;
            if found.key.local_name().as_ref() == attribute.as_bytes() {
                let text = found.unescape_value().map_err(|e| fault(e.to_string()))?;
                return Ok(Some(text.into_owned()));
            }
        }
        Ok(None)
    }

    fn parsed<T: std::str::FromStr>(
        &self,
        attribute: &'static str,
        expected: &'static str,
    ) -> Result<T, ThreeMfError> {
        let text = self.text(attribute)?.unwrap_or_default();
        text.trim().parse().or_else(|_| self.fault(attribute, text, expected))
    }

    fn fault<T>(
        &self,
        attribute: &'static str,
        found: String,
        expected: &'static str,
    ) -> Result<T, ThreeMfError> {
        Err(ThreeMfError::Attribute { at: self.at, element: self.name, attribute, found, expected })
    }

    /// Refuses extensions that the model needs and that may change its shapes.
    fn extensions(&self) -> Result<(), ThreeMfError> {
        let Some(needed) = self.text("requiredextensions")? else { return Ok(()) };
        let is_harmless = |space: String| HARMLESS.iter().any(|known| space.contains(known));
        for prefix in needed.split_ascii_whitespace() {
            // `xmlns:p` names the space of the prefix p.
            if !self.text(prefix)?.is_some_and(is_harmless) {
                return Err(ThreeMfError::Extension(prefix.to_owned()));
            }
        }
        Ok(())
    }

    /// Whether an item is to be printed.
    fn is_printable(&self) -> Result<bool, ThreeMfError> {
        Ok(!matches!(self.text("printable")?.as_deref(), Some("0" | "false")))
    }

    /// The type of an object.
    fn role(&self) -> Result<Role, ThreeMfError> {
        let text = self.text("type")?.unwrap_or_else(|| "model".to_owned());
        match ROLES.iter().find(|(word, _)| *word == text) {
            Some((_, role)) => Ok(*role),
            None => self.fault("type", text, "model, solidsupport, support, surface or other"),
        }
    }

    /// The object that is to be put somewhere, and where.
    fn placed(&self) -> Result<(u32, Transform), ThreeMfError> {
        if self.text("path")?.is_some() {
            return Err(ThreeMfError::OtherPart);
        }
        let object = self.parsed("objectid", "the number of an object")?;
        let Some(text) = self.text("transform")? else { return Ok((object, Transform::scaled(1.0))) };
        let numbers: Vec<f64> = text.split_ascii_whitespace().map_while(|w| w.parse().ok()).collect();
        let transform = <[f64; 12]>::try_from(numbers).ok().filter(|n| n.iter().all(|v| v.is_finite()));
        match transform {
            Some(numbers) => Ok((object, Transform(numbers))),
            None => self.fault("transform", text, "twelve numbers"),
        }
    }
}

/// Three rows that turn and scale, and one that moves; points are rows that stand before it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Transform([f64; 12]);

impl Transform {
    const fn scaled(by: f64) -> Self {
        Self([by, 0.0, 0.0, 0.0, by, 0.0, 0.0, 0.0, by, 0.0, 0.0, 0.0])
    }

    fn turned(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| x * self.0[k] + y * self.0[3 + k] + z * self.0[6 + k])
    }

    fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        let turned = self.turned(p);
        [0, 1, 2].map(|k| turned[k] + self.0[9 + k])
    }

    /// This one first, then the other.
    fn then(&self, next: &Self) -> Self {
        let row = |k: usize| [self.0[k], self.0[k + 1], self.0[k + 2]];
        let rows = [next.turned(row(0)), next.turned(row(3)), next.turned(row(6)), next.apply(row(9))];
        let mut numbers = [0.0; 12];
        numbers.iter_mut().zip(rows.as_flattened()).for_each(|(to, from)| *to = *from);
        Self(numbers)
    }

    fn mirrors(&self) -> bool {
        let m = &self.0;
        let by_z = [m[1] * m[5] - m[2] * m[4], m[2] * m[3] - m[0] * m[5], m[0] * m[4] - m[1] * m[3]];
        by_z[0] * m[6] + by_z[1] * m[7] + by_z[2] * m[8] < 0.0
    }
}

/// What an object is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Role {
    /// To be printed.
    #[default]
    Model,
    /// All else, by its word.
    NoPart(&'static str),
}

/// The types that an object may have.
const ROLES: [(&str, Role); 5] = [
    ("model", Role::Model),
    ("solidsupport", Role::NoPart("solidsupport")),
    ("support", Role::NoPart("support")),
    ("surface", Role::NoPart("surface")),
    ("other", Role::NoPart("other")),
];

/// A mesh and what else the object is made of.
#[derive(Debug, Default)]
struct Object {
    role: Role,
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    components: Vec<(u32, Transform)>,
}

/// What was placed so far.
#[derive(Debug, Default)]
struct Built {
    facets: Vec<Facet>,
    n_objects: usize,
    /// Objects that are no part, and their types.
    n_no_part: usize,
    no_part: BTreeSet<&'static str>,
}

impl Built {
    fn no_part(&self) -> Option<Warning> {
        let types = self.no_part.iter().copied().collect::<Vec<_>>().join(", ");
        let text = match self.n_no_part {
            0 => return None,
            1 => format!("1 object of another type than model ({types}) was left out: it is no part"),
            n => format!("{n} objects of other types than model ({types}) were left out: they are no part"),
        };
        Some(Warning::new("model.no_part", text))
    }
}

#[derive(Debug, Default)]
struct Document {
    unit_mm: f64,
    objects: BTreeMap<u32, Object>,
    items: Vec<(u32, Transform)>,
    /// Items that are not to be printed.
    n_not_printable: usize,
}

impl Document {
    fn of(part: &[u8]) -> Result<Self, ThreeMfError> {
        let mut document = Self { unit_mm: 1.0, ..Self::default() };
        let mut current: Option<(u32, Object)> = None;
        elements(part, |tag, at| {
            match tag {
                Tag::Start(start) => document.start(start, at, &mut current)?,
                Tag::End(b"object") => document.objects.extend(current.take()),
                Tag::End(_) => {}
            }
            Ok(())
        })?;
        Ok(document)
    }

    fn start(
        &mut self,
        start: &BytesStart<'_>,
        at: u64,
        current: &mut Option<(u32, Object)>,
    ) -> Result<(), ThreeMfError> {
        let element = |name| Element { start, name, at };
        let name = start.local_name();
        match (name.as_ref(), current.as_mut()) {
            (b"model", _) => {
                self.unit_mm = unit_mm(&element("model"))?;
                element("model").extensions()?;
            }
            (b"object", _) => {
                let object = Object { role: element("object").role()?, ..Object::default() };
                *current = Some((element("object").parsed("id", "a number")?, object));
            }
            (b"vertex", Some((_, object))) => object.vertices.push(vertex(&element("vertex"))?),
            (b"triangle", Some((_, object))) => object.triangles.push(triangle(&element("triangle"))?),
            (b"component", Some((_, object))) => object.components.push(element("component").placed()?),
            (b"item", _) if element("item").is_printable()? => self.items.push(element("item").placed()?),
            (b"item", _) => self.n_not_printable += 1,
            _ => {}
        }
        self.check(current.as_ref().map(|(_, object)| object))
    }

    fn not_printable(&self) -> Option<Warning> {
        let text = match self.n_not_printable {
            0 => return None,
            1 => "1 object that the file marks as not to be printed was left out".to_owned(),
            n => format!("{n} objects that the file marks as not to be printed were left out"),
        };
        Some(Warning::new("model.not_printable", text))
    }

    /// Refuses what is larger than any model while it is read.
    fn check(&self, current: Option<&Object>) -> Result<(), ThreeMfError> {
        let is_large = |o: &Object| {
            o.triangles.len().max(o.vertices.len()) > MOST_TRIANGLES || o.components.len() > MOST_OBJECTS
        };
        let n_objects = self.items.len().max(self.objects.len());
        if n_objects > MOST_OBJECTS || current.is_some_and(is_large) {
            Err(ThreeMfError::TooLarge)
        } else {
            Ok(())
        }
    }

    /// Appends an object's triangles where it is placed, and those of its components.
    fn place(
        &self,
        number: u32,
        transform: Transform,
        depth: usize,
        built: &mut Built,
    ) -> Result<(), ThreeMfError> {
        let object = self.objects.get(&number).filter(|_| depth > 0).ok_or(ThreeMfError::Object(number))?;
        built.n_objects += 1;
        if let Role::NoPart(word) = object.role {
            built.n_no_part += 1;
            built.no_part.insert(word);
            return if built.n_objects > MOST_OBJECTS { Err(ThreeMfError::TooLarge) } else { Ok(()) };
        }
        let n_triangles = built.facets.len() + object.triangles.len();
        if n_triangles > MOST_TRIANGLES || built.n_objects > MOST_OBJECTS {
            return Err(ThreeMfError::TooLarge);
        }
        let n_vertices = object.vertices.len();
        let corner = |vertex: u32| {
            let at = object.vertices.get(vertex as usize);
            #[expect(clippy::cast_possible_truncation, reason = "facets are in 32-bit floats")]
            let placed = |p: &[f64; 3]| transform.apply(*p).map(|c| c as f32);
            at.map(placed).ok_or(ThreeMfError::Vertex { object: number, vertex, n_vertices })
        };
        let mirrors = transform.mirrors();
        for &[a, b, c] in &object.triangles {
            let [b, c] = if mirrors { [c, b] } else { [b, c] };
            built.facets.push([corner(a)?, corner(b)?, corner(c)?]);
        }
        for (component, placed) in &object.components {
            self.place(*component, placed.then(&transform), depth - 1, built)?;
        }
        Ok(())
    }
}

fn vertex(element: &Element<'_>) -> Result<[f64; 3], ThreeMfError> {
    let number = |name| element.parsed(name, "a number");
    Ok([number("x")?, number("y")?, number("z")?])
}

fn triangle(element: &Element<'_>) -> Result<[u32; 3], ThreeMfError> {
    let number = |name| element.parsed(name, "the number of a vertex");
    Ok([number("v1")?, number("v2")?, number("v3")?])
}

fn unit_mm(element: &Element<'_>) -> Result<f64, ThreeMfError> {
    let unit = element.text("unit")?;
    Ok(match unit.as_deref() {
        None | Some("millimeter") => 1.0,
        Some("micron") => 1e-3,
        Some("centimeter") => 10.0,
        Some("inch") => 25.4,
        Some("foot") => 304.8,
        Some("meter") => 1e3,
        Some(other) => {
            let expected = "micron, millimeter, centimeter, inch, foot or meter";
            return element.fault("unit", other.to_owned(), expected);
        }
    })
}

#[cfg(test)]
mod tests;
