//! A mesh as 3MF (*3D Manufacturing Format, Core Specification*, 1.3): millimetres, one object a body, welded vertices.
//!
//! Coordinates are 32-bit floats in their shortest decimal form: what is read is what an STL of the same mesh holds.
//! Colours of vertices, where they are given, go into a colour group (*Materials and Properties Extension*, 1.2.1), which
//! programs that know nothing of it pass over. The archive has no dates and the model no names but those given: the
//! same mesh gives the same bytes.

use super::{TriMesh, bodies};
use crate::geom::Point3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::io::{Cursor, Write as _};
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

const CONTENT_TYPES: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>
"#;
const RELATIONSHIPS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel" Target="/3D/3dmodel.model"/></Relationships>
"#;
const MODEL_START: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02" xmlns:lumenfab="urn:lumenfab:metadata:1">
"#;
const MODEL_PART: &str = "3D/3dmodel.model";
/// Resource of the colours.
const COLOURS: u32 = 1;
/// Elements that a thread writes at once.
const BLOCK: usize = 4096;

/// What a model says about itself.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Description {
    /// What the bodies are: `wall`, `cast`, `lumen`.
    pub body: String,
    /// Facts by name, letters and digits only, in the order they are written.
    pub facts: Vec<(&'static str, String)>,
}

/// The colour of a vertex: red, green, blue.
pub type Colour = [u8; 3];

/// The file's bytes; `colours` has one for each vertex of the mesh, or is empty.
///
/// # Panics
/// Where there are colours, but not one a vertex.
#[must_use]
pub fn to_bytes(mesh: &TriMesh, colours: &[Colour], about: &Description) -> Vec<u8> {
    assert!(colours.is_empty() || colours.len() == mesh.vertices.len(), "one colour a vertex");
    let parts = [
        ("[Content_Types].xml", CONTENT_TYPES),
        ("_rels/.rels", RELATIONSHIPS),
        (MODEL_PART, &model(mesh, colours, about)),
    ];
    package(&parts).expect("a vector takes every byte")
}

/// An archive of the parts that is the same whenever it is written: its date is the earliest that the format knows.
fn package(parts: &[(&str, &str)]) -> ZipResult<Vec<u8>> {
    let undated = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(DateTime::default());
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, contents) in parts {
        let is_large = u32::try_from(contents.len()).is_err();
        archive.start_file(*name, undated.large_file(is_large))?;
        archive.write_all(contents.as_bytes())?;
    }
    Ok(archive.finish()?.into_inner())
}

fn model(mesh: &TriMesh, colours: &[Colour], about: &Description) -> String {
    let palette = Palette::of(mesh, colours);
    let mut text = MODEL_START.to_owned();
    metadata(&mut text, "Application", concat!("lumenfab ", env!("CARGO_PKG_VERSION")));
    for (name, value) in &about.facts {
        metadata(&mut text, &format!("lumenfab:{name}"), value);
    }
    text += "<resources>\n";
    palette.write(&mut text);
    let bodies = bodies(mesh);
    for (k, body) in bodies.iter().enumerate() {
        object(&mut text, k, body, about, &palette);
    }
    text += "</resources>\n<build>\n";
    for k in 0..bodies.len() {
        put(&mut text, format_args!("<item objectid=\"{}\"/>\n", object_id(k)));
    }
    text += "</build>\n</model>\n";
    text
}

fn put(text: &mut String, what: std::fmt::Arguments<'_>) {
    text.write_fmt(what).expect("a string takes every text");
}

fn metadata(text: &mut String, name: &str, value: &str) {
    put(text, format_args!("<metadata name=\"{name}\">{}</metadata>\n", escaped(value)));
}

/// Text as it may stand between tags and in attributes.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn object_id(body: usize) -> usize {
    body + 1 + COLOURS as usize
}

fn object(text: &mut String, k: usize, body: &TriMesh, about: &Description, palette: &Palette) {
    let (id, name) = (object_id(k), escaped(&about.body));
    let default_colour =
        if palette.colours.is_empty() { String::new() } else { format!(" pid=\"{COLOURS}\" pindex=\"0\"") };
    put(
        text,
        format_args!("<object id=\"{id}\" type=\"model\" name=\"{name} {}\"{default_colour}>\n", k + 1),
    );
    *text += "<mesh>\n<vertices>\n";
    in_blocks(text, &body.vertices, |text, p| {
        let [x, y, z] = single(*p);
        put(text, format_args!("<vertex x=\"{x}\" y=\"{y}\" z=\"{z}\"/>\n"));
    });
    *text += "</vertices>\n<triangles>\n";
    in_blocks(text, &body.triangles, |text, t| {
        let [a, b, c] = t;
        put(text, format_args!("<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\""));
        if !palette.colours.is_empty() {
            let [p, q, r] = t.map(|v| palette.at(body.vertices[v as usize]));
            put(text, format_args!(" pid=\"{COLOURS}\" p1=\"{p}\" p2=\"{q}\" p3=\"{r}\""));
        }
        *text += "/>\n";
    });
    *text += "</triangles>\n</mesh>\n</object>\n";
}

/// Writes many elements, blocks of them at the same time, in their order.
fn in_blocks<T: Sync>(text: &mut String, elements: &[T], write: impl Fn(&mut String, &T) + Sync) {
    let block = |elements: &[T]| {
        let mut text = String::new();
        elements.iter().for_each(|e| write(&mut text, e));
        text
    };
    let blocks: Vec<String> = elements.par_chunks(BLOCK).map(block).collect();
    text.extend(blocks);
}

#[expect(clippy::cast_possible_truncation, reason = "the precision of the file")]
fn single(p: Point3) -> [f32; 3] {
    [p.x as f32 + 0.0, p.y as f32 + 0.0, p.z as f32 + 0.0]
}

/// The different colours of a mesh, and which one each place has.
struct Palette {
    colours: Vec<Colour>,
    at: BTreeMap<[u32; 3], usize>,
}

impl Palette {
    fn of(mesh: &TriMesh, of_vertices: &[Colour]) -> Self {
        let mut colours = of_vertices.to_vec();
        colours.sort_unstable();
        colours.dedup();
        let place = |c: &Colour| colours.binary_search(c).expect("each is there");
        let at = mesh.vertices.iter().zip(of_vertices).map(|(p, c)| (key(*p), place(c))).collect();
        Self { colours, at }
    }

    fn at(&self, p: Point3) -> usize {
        self.at.get(&key(p)).copied().unwrap_or(0)
    }

    fn write(&self, text: &mut String) {
        if self.colours.is_empty() {
            return;
        }
        put(text, format_args!("<m:colorgroup id=\"{COLOURS}\">\n"));
        for [r, g, b] in &self.colours {
            put(text, format_args!("<m:color color=\"#{r:02X}{g:02X}{b:02X}\"/>\n"));
        }
        *text += "</m:colorgroup>\n";
    }
}

fn key(p: Point3) -> [u32; 3] {
    single(p).map(f32::to_bits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    fn cube(at: f64) -> TriMesh {
        let corner =
            |i: u32| Point3::new(at + f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2) / 3.0);
        let side = |[a, b, c, d]: [u32; 4]| [[a, b, c], [a, c, d]];
        let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        TriMesh {
            vertices: (0..8).map(corner).collect(),
            triangles: sides.into_iter().flat_map(side).collect(),
        }
    }

    fn two_cubes() -> TriMesh {
        let (mut both, other) = (cube(-0.1), cube(5.0));
        both.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + 8)));
        both.vertices.extend(other.vertices);
        both
    }

    fn about() -> Description {
        Description {
            body: "wall".into(),
            facts: vec![("DeflectionMm", "0.01".into()), ("Skin", "a<b&c".into())],
        }
    }

    fn parts_of(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
        let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
        let n_parts = archive.len();
        let part = |k| {
            let mut part = archive.by_index(k).unwrap();
            let mut contents = Vec::new();
            part.read_to_end(&mut contents).unwrap();
            (part.name().unwrap().into_owned(), contents)
        };
        (0..n_parts).map(part).collect()
    }

    fn model_of(bytes: &[u8]) -> String {
        let parts = parts_of(bytes);
        let names: Vec<&str> = parts.iter().map(|p| p.0.as_str()).collect();
        assert_eq!(names, ["[Content_Types].xml", "_rels/.rels", MODEL_PART]);
        String::from_utf8(parts[2].1.clone()).unwrap()
    }

    /// The values of an attribute of all elements of a kind.
    fn values<'a>(model: &'a str, element: &str, attribute: &str) -> Vec<&'a str> {
        let start = format!("{attribute}=\"");
        model
            .split('<')
            .filter(|e| e.split(' ').next() == Some(element))
            .filter_map(|e| e.split_once(&start)?.1.split('"').next())
            .collect()
    }

    #[test]
    fn bodies_are_objects_with_their_vertices_and_triangles_read_back() {
        let mesh = two_cubes().in_single_precision();
        let model = model_of(&to_bytes(&mesh, &[], &about()));
        assert!(model.contains("<model unit=\"millimeter\""));
        assert_eq!(values(&model, "object", "id"), values(&model, "item", "objectid"));
        assert_eq!(values(&model, "object", "name"), ["wall 1", "wall 2"]);
        let [x, y, z] = ["x", "y", "z"].map(|k| -> Vec<f64> {
            values(&model, "vertex", k).iter().map(|v| f64::from(v.parse::<f32>().unwrap())).collect()
        });
        let vertices: Vec<Point3> = (0..x.len()).map(|i| Point3::new(x[i], y[i], z[i])).collect();
        // Bodies list their vertices as their triangles use them.
        let bodies = bodies(&mesh);
        assert_eq!(vertices, [&bodies[0].vertices[..], &bodies[1].vertices[..]].concat());
        let [a, b, c] = ["v1", "v2", "v3"].map(|k| -> Vec<u32> {
            values(&model, "triangle", k).iter().map(|v| v.parse().unwrap()).collect()
        });
        let triangles: Vec<[u32; 3]> = (0..a.len()).map(|i| [a[i], b[i], c[i]]).collect();
        assert_eq!(triangles, [&bodies[0].triangles[..], &bodies[1].triangles[..]].concat());
    }

    #[test]
    fn the_model_tells_its_program_and_facts_and_nothing_of_when() {
        let bytes = to_bytes(&cube(0.0), &[], &about());
        let model = model_of(&bytes);
        let application =
            format!("<metadata name=\"Application\">lumenfab {}</metadata>", env!("CARGO_PKG_VERSION"));
        assert!(model.contains(&application));
        assert!(model.contains("<metadata name=\"lumenfab:DeflectionMm\">0.01</metadata>"));
        assert!(model.contains("<metadata name=\"lumenfab:Skin\">a&lt;b&amp;c</metadata>"));
        assert!(!model.contains("Date") && !model.contains("colorgroup"));
        assert_eq!(bytes, to_bytes(&cube(0.0), &[], &about()));
    }

    #[test]
    fn colours_of_vertices_are_named_by_the_triangles() {
        let mesh = cube(0.0);
        let colours: Vec<Colour> = (0..8).map(|i| if i < 4 { [255, 0, 16] } else { [1, 2, 3] }).collect();
        let model = model_of(&to_bytes(&mesh, &colours, &about()));
        assert_eq!(values(&model, "m:color", "color"), ["#010203", "#FF0010"]);
        // The bottom, the top, the front's first triangle.
        assert_eq!(values(&model, "triangle", "p3")[..5], ["1", "1", "0", "0", "0"]);
        assert!(values(&model, "triangle", "pid").iter().all(|&pid| pid == "1"));
    }
}
