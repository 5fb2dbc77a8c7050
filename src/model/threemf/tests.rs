use super::*;
use crate::mesh::threemf::{Description, to_bytes};
use crate::model::Model;
use crate::model::testing::cuboid;

/// A package of parts that are stored as they are.
fn package(parts: &[(&str, &str)]) -> Vec<u8> {
    let (mut bytes, mut directory) = (Vec::new(), Vec::new());
    for (name, contents) in parts {
        let offset = u32::try_from(bytes.len()).unwrap();
        let mut crc = flate2::Crc::new();
        crc.update(contents.as_bytes());
        let length = u32::try_from(contents.len()).unwrap();
        let mut header: Vec<u8> = [20u16, 0, 0, 0, 0x21].iter().flat_map(|f| f.to_le_bytes()).collect();
        header.extend([crc.sum(), length, length].iter().flat_map(|f| f.to_le_bytes()));
        header.extend(u16::try_from(name.len()).unwrap().to_le_bytes());
        header.extend([0, 0]);
        bytes.extend(b"PK\x03\x04");
        bytes.extend(&header);
        bytes.extend(name.bytes().chain(contents.bytes()));
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&header);
        directory.extend([0; 10]);
        directory.extend(offset.to_le_bytes());
        directory.extend(name.bytes());
    }
    let n = u16::try_from(parts.len()).unwrap();
    let sizes = [directory.len(), bytes.len()].map(|n| u32::try_from(n).unwrap().to_le_bytes());
    bytes.extend(&directory);
    bytes.extend(b"PK\x05\x06\x00\x00\x00\x00");
    bytes.extend([n.to_le_bytes(), n.to_le_bytes()].concat());
    bytes.extend(sizes.concat());
    bytes.extend([0, 0]);
    bytes
}

const RELS: &str = r#"<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="a" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel" Target="/3D/a.model"/></Relationships>"#;

/// A package whose model has this unit, these objects and build items.
fn model(unit: &str, resources: &str, items: &str) -> Vec<u8> {
    let text = format!(
        r#"<?xml version="1.0"?><model unit="{unit}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>{resources}</resources><build>{items}</build></model>"#
    );
    package(&[("_rels/.rels", RELS), ("3D/a.model", &text)])
}

const CORNER: &str = r#"<object id="1" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/><vertex x="0" y="0" z="1"/></vertices><triangles><triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/><triangle v1="1" v2="2" v3="3"/><triangle v1="0" v2="3" v3="2"/></triangles></mesh></object>"#;

fn volume_mm3(bytes: &[u8]) -> f64 {
    let model = Model::of(&read(bytes).unwrap()).unwrap();
    assert!(model.warnings.is_empty(), "{:?}", model.warnings);
    model.mesh.volume_mm3()
}

#[test]
fn what_is_written_is_read_again() {
    let model = Model::of(&cuboid([1.5, 2.0, 3.25])).unwrap();
    let bytes = to_bytes(&model.mesh, &[], &Description::default()).unwrap();
    assert!(is_package(&bytes));
    assert_eq!(Model::of(&read(&bytes).unwrap()).unwrap(), model);
}

#[test]
fn units_are_converted() {
    for (unit, mm) in [("millimeter", 1.0f64), ("inch", 25.4), ("centimeter", 10.0), ("micron", 1e-3)] {
        let volume = volume_mm3(&model(unit, CORNER, r#"<item objectid="1"/>"#));
        assert!((volume / (mm.powi(3) / 6.0) - 1.0).abs() < 1e-6, "{unit}: {volume}");
    }
}

#[test]
fn components_and_items_are_placed_one_after_the_other_and_mirrored_ones_turned() {
    // Twice as large and moved in the component, then mirrored in x and moved in the item.
    let resources = format!(
        r#"{CORNER}<object id="2"><components><component objectid="1" transform="2 0 0 0 2 0 0 0 2 1 0 0"/></components></object>"#
    );
    let items = r#"<item objectid="2" transform="-1 0 0 0 1 0 0 0 1 0 0 5"/>"#;
    let bytes = model("millimeter", &resources, items);
    assert!((volume_mm3(&bytes) - 8.0 / 6.0).abs() < 1e-6);
    let facets = read(&bytes).unwrap();
    let range = |k: usize| {
        let all = facets.iter().flatten().map(|p| p[k]);
        [all.clone().fold(f32::INFINITY, f32::min), all.fold(f32::NEG_INFINITY, f32::max)]
    };
    assert_eq!([range(0), range(1), range(2)], [[-3.0, -1.0], [0.0, 2.0], [5.0, 7.0]]);
}

/// A model that needs an extension.
fn needing(prefix: &str, space: &str) -> Vec<u8> {
    let text = format!(
        r#"<model xmlns:{prefix}="{space}" requiredextensions="{prefix}"><resources>{CORNER}</resources><build><item objectid="1"/></build></model>"#
    );
    package(&[("_rels/.rels", RELS), ("3D/a.model", &text)])
}

#[test]
fn a_model_that_needs_what_leaves_shapes_alone_is_read() {
    let materials = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02";
    assert_eq!(read(&needing("m", materials)).unwrap().len(), 4);
}

#[test]
fn only_what_is_to_be_built_is_read() {
    let other = CORNER.replace(r#"id="1""#, r#"id="7""#);
    let items = r#"<item objectid="1"/><item objectid="1" transform="1 0 0 0 1 0 0 0 1 9 0 0"/>"#;
    let bytes = model("millimeter", &format!("{CORNER}{other}"), items);
    assert_eq!(read(&bytes).unwrap().len(), 8);
}

#[test]
fn each_fault_is_named_with_what_was_found() {
    let item = r#"<item objectid="1"/>"#;
    let of = |resources: &str, items: &str| model("millimeter", resources, items);
    let circle = r#"<object id="1"><components><component objectid="1"/></components></object>"#;
    let many = |id: u32| {
        let component = format!(r#"<component objectid="{}"/>"#, id + 1).repeat(10);
        format!(r#"<object id="{id}"><components>{component}</components></object>"#)
    };
    let laughs = format!("{}<object id=\"21\"/>", (1..21).map(many).collect::<String>());
    let mut damaged = of(CORNER, item);
    let at = damaged.windows(6).position(|w| w == b"vertex").unwrap();
    damaged[at] = b'w';
    for (bytes, expected) in [
        (b"PK\x03\x04 and nothing more".to_vec(), "no ZIP archive, or its end is missing"),
        (package(&[("a", "b")]), "no relationships"),
        (package(&[("_rels/.rels", RELS)]), "no 3D model"),
        (damaged, "the archive is damaged"),
        (model("furlong", CORNER, item), "found unit \"furlong\""),
        (of(&CORNER.replace(r#"x="1""#, r#"x="one""#), item), "found x \"one\", expected a number"),
        (of(&CORNER.replace(r#"v3="3""#, r#"v3="4""#), item), "names vertex 4 of 4"),
        (of(CORNER, r#"<item objectid="3"/>"#), "object 3 is to be built but not there"),
        (of(CORNER, r#"<item objectid="1" transform="1 0"/>"#), "expected twelve numbers"),
        (of(CORNER, r#"<item objectid="1" p:path="/3D/b.model"/>"#), "parts of their own"),
        (of(circle, item), "part of itself"),
        (of(&laughs, item), "1000000 objects"),
        (of("<object id=\"1\"><mesh></object>", item), "byte "),
        (
            needing("b", "http://schemas.microsoft.com/3dmanufacturing/booleanoperations/2023/07"),
            "the extension \"b\"",
        ),
    ] {
        let text = read(&bytes).unwrap_err().to_string();
        assert!(text.contains(expected), "{expected}: {text}");
    }
}

#[test]
fn no_bytes_make_it_panic() {
    let good = model("millimeter", CORNER, r#"<item objectid="1"/>"#);
    for at in 0..good.len() {
        for bits in [0x01, 0x80, 0xff] {
            let mut bad = good.clone();
            bad[at] ^= bits;
            drop(read(&bad));
        }
        drop(read(&good[..at]));
    }
}
