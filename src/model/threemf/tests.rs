use super::*;
use crate::mesh::threemf::{Description, to_bytes};
use crate::model::Model;
use crate::model::testing::cuboid;
use std::io::{Cursor, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A package of parts that are stored as they are.
fn package(parts: &[(&str, &str)]) -> Vec<u8> {
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    packed(parts, stored)
}

fn packed(parts: &[(&str, &str)], how: SimpleFileOptions) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, contents) in parts {
        archive.start_file(*name, how).unwrap();
        archive.write_all(contents.as_bytes()).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

const RELS: &str = r#"<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="a" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel" Target="/3D/a.model"/></Relationships>"#;

/// A model in this unit, of these objects and build items.
fn text(unit: &str, resources: &str, items: &str) -> String {
    format!(
        r#"<?xml version="1.0"?><model unit="{unit}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>{resources}</resources><build>{items}</build></model>"#
    )
}

/// A package of such a model.
fn model(unit: &str, resources: &str, items: &str) -> Vec<u8> {
    package(&[("_rels/.rels", RELS), ("3D/a.model", &text(unit, resources, items))])
}

const ITEM: &str = r#"<item objectid="1"/>"#;

const CORNER: &str = r#"<object id="1" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/><vertex x="0" y="0" z="1"/></vertices><triangles><triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/><triangle v1="1" v2="2" v3="3"/><triangle v1="0" v2="3" v3="2"/></triangles></mesh></object>"#;

fn volume_mm3(bytes: &[u8]) -> f64 {
    let model = Model::of(&read(bytes).unwrap().facets).unwrap();
    assert!(model.warnings.is_empty(), "{:?}", model.warnings);
    model.mesh.volume_mm3()
}

#[test]
fn what_is_written_is_read_again() {
    let model = Model::of(&cuboid([1.5, 2.0, 3.25])).unwrap();
    let bytes = to_bytes(&model.mesh, &[], &Description::default());
    assert!(is_package(&bytes));
    assert_eq!(Model::of(&read(&bytes).unwrap().facets).unwrap(), model);
}

#[test]
fn packages_of_the_large_kind_and_names_in_other_letters_are_read() {
    let text = text("millimeter", CORNER, ITEM);
    for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        // What lib3mf writes, however small it is.
        let large = SimpleFileOptions::default().compression_method(method).large_file(true);
        let bytes = packed(&[("_RELS/.rels", RELS), ("3d/A.model", &text)], large);
        assert_eq!(read(&bytes).unwrap().facets.len(), 4);
    }
}

#[test]
fn a_small_file_asks_for_no_memory() {
    let air = " ".repeat(3 << 20);
    let deflated = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
    let bytes = packed(&[("_rels/.rels", RELS), ("3D/a.model", &air)], deflated);
    let refused = read(&bytes).unwrap_err().to_string();
    assert!(refused.contains("claims 3145728 bytes from"), "{refused}");
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
    let facets = read(&bytes).unwrap().facets;
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
    assert_eq!(read(&needing("m", materials)).unwrap().facets.len(), 4);
}

#[test]
fn only_what_is_to_be_built_is_read() {
    let other = CORNER.replace(r#"id="1""#, r#"id="7""#);
    let items = r#"<item objectid="1"/><item objectid="1" transform="1 0 0 0 1 0 0 0 1 9 0 0"/>"#;
    let bytes = model("millimeter", &format!("{CORNER}{other}"), items);
    assert_eq!(read(&bytes).unwrap().facets.len(), 8);
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
        (b"PK\x03\x04 and nothing more".to_vec(), "no ZIP archive, or a damaged one"),
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
fn no_package_makes_it_panic() {
    let good = model("millimeter", CORNER, ITEM);
    for at in 0..good.len() {
        for bits in [0x01, 0x80, 0xff] {
            let mut bad = good.clone();
            bad[at] ^= bits;
            drop(read(&bad));
        }
        drop(read(&good[..at]));
    }
}

/// Packed anew after each damage: a checksum keeps damaged packages from being looked into.
#[test]
fn no_model_makes_it_panic() {
    let good = text("millimeter", CORNER, ITEM);
    let mut n_read = 0;
    for at in 0..good.len() {
        for byte in *b"0<\"/>& -" {
            let mut bad = good.clone().into_bytes();
            bad[at] = byte;
            let bad = String::from_utf8(bad).unwrap();
            n_read += usize::from(read(&package(&[("_rels/.rels", RELS), ("3D/a.model", &bad)])).is_ok());
        }
    }
    // Some damages are none: a digit for another.
    assert!((1..good.len() * 8).contains(&n_read), "{n_read}");
}

#[test]
fn items_and_objects_that_are_not_to_be_printed_are_left_out_and_told() {
    let object = |id: u32, kind: &str| {
        CORNER.replacen("id=\"1\" type=\"model\"", &format!("id=\"{id}\" type=\"{kind}\""), 1)
    };
    let kinds = ["model", "solidsupport", "support", "surface", "other"];
    let objects: String = (1..).zip(kinds).map(|(id, kind)| object(id, kind)).collect();
    let items: String = (1..=5)
        .map(|id| format!(r#"<item objectid="{id}" transform="1 0 0 0 1 0 0 0 1 {id}0 0 0"/>"#))
        .collect();
    let off = r#"<item objectid="1" printable="0" transform="1 0 0 0 1 0 0 0 1 90 0 0"/>"#;
    let package = read(&model("millimeter", &objects, &format!("{items}{off}"))).unwrap();
    assert_eq!(package.facets.len(), 4);
    let told: Vec<_> = package.warnings.iter().map(|w| (w.code.as_str(), w.text.as_str())).collect();
    assert_eq!(
        told,
        [
            ("model.not_printable", "1 object that the file marks as not to be printed was left out"),
            (
                "model.no_part",
                "4 objects of other types than model (other, solidsupport, support, surface) were left out: they are no part"
            ),
        ]
    );
}

#[test]
fn what_a_part_is_put_together_of_is_left_out_by_its_type_too() {
    let support = CORNER.replacen("id=\"1\" type=\"model\"", "id=\"2\" type=\"support\"", 1);
    let plain = CORNER.replacen(" type=\"model\"", "", 1);
    let whole = r#"<object id="3"><components><component objectid="1"/><component objectid="2"/></components></object>"#;
    let package = read(&model(
        "millimeter",
        &format!("{plain}{support}{whole}"),
        r#"<item objectid="3" printable="1"/>"#,
    ))
    .unwrap();
    assert_eq!((package.facets.len(), package.warnings.len()), (4, 1));
    assert!(
        package.warnings[0].text.starts_with("1 object of another type than model (support) was left out")
    );
}

#[test]
fn a_file_of_nothing_to_print_is_refused_with_the_reason() {
    let off = read(&model("millimeter", CORNER, r#"<item objectid="1" printable="0"/>"#)).unwrap_err();
    assert!(off.to_string().contains("nothing in it is to be printed"), "{off}");
    let unknown = CORNER.replacen("type=\"model\"", "type=\"wood\"", 1);
    let unknown = read(&model("millimeter", &unknown, ITEM)).unwrap_err();
    assert!(unknown.to_string().contains("found type \"wood\", expected model, solidsupport"), "{unknown}");
}

#[test]
fn objects_that_are_placed_nowhere_are_told() {
    assert_eq!(read(&model("millimeter", CORNER, "")).unwrap_err(), ThreeMfError::NothingPlaced);
}
