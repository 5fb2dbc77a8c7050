//! The description and what is there are one.

use super::*;
use std::collections::BTreeSet;

const METHODS: [&str; 5] = ["GET", "POST", "PUT", "PATCH", "DELETE"];

#[tokio::test]
async fn every_route_is_described_and_nothing_else() {
    let site = Site::open().await;
    let document = site.get("/api/v1/openapi.json").await.json();
    let paths = document["paths"].as_object().unwrap();
    let known: BTreeSet<_> = routes::<Sqlite>().into_iter().map(|(path, _)| path).collect();
    assert_eq!(paths.keys().map(String::as_str).collect::<BTreeSet<_>>(), known);
    for path in known.into_iter().filter(|path| !path.ends_with("/events")) {
        for method in METHODS {
            let at = path.replace("{id}", "none").replace("{name}", "none").replace("{index}", "0");
            let is_there = site.ask(method, &at, None).await.status != 405;
            let is_described = paths[path].get(method.to_lowercase()).is_some();
            assert_eq!(is_there, is_described, "{method} {path}");
        }
    }
    site.end().await;
}

#[tokio::test]
async fn the_description_is_whole() {
    let site = Site::open().await;
    let document = site.get("/api/v1/openapi.json").await.json();
    let text = document.to_string();
    let schemas = document["components"]["schemas"].as_object().unwrap();
    for part in text.split("#/components/schemas/").skip(1) {
        let name = part.split('"').next().unwrap();
        assert!(schemas.contains_key(name), "{name} is referred to, but not described");
    }
    for schema in ["JobView", "Anew", "Turn", "BedClear", "Schedule", "ErrorBody"] {
        assert!(schemas.contains_key(schema), "{schema}");
    }
    assert!(document["components"]["securitySchemes"]["key"]["name"] == "X-Api-Key");
    site.end().await;
}
