//! Keys and roles, over TCP.

use super::*;
use crate::http::serve::BindError;
use std::os::unix::fs::PermissionsExt;

/// A key that may operate.
pub(super) const OPERATE: &str = "4D1F0E8B93A67C25B0D95E8137AC64F2";

fn with_key(method: &str, path: &str, header: &str) -> Vec<u8> {
    request(method, path, None, header).into_bytes()
}

async fn asked(site: &Site, path: &str, header: &str) -> Answer {
    site.tcp(&with_key("GET", path, header)).await
}

#[tokio::test]
async fn over_tcp_nothing_goes_without_a_good_key() {
    let site = Site::with(Edge::default(), true).await;
    let whoami = "/api/v1/whoami";
    let missing = asked(&site, whoami, "").await;
    assert_eq!(missing.refusal(), no(401, "http.no_key"));
    assert!(missing.head.contains("www-authenticate: bearer"));
    assert_eq!(asked(&site, whoami, "X-Api-Key: secret\r\n").await.refusal(), no(401, "http.weak_key"));
    let wrong = "X-Api-Key: 5D1F0E8B93A67C25B0D95E8137AC64F2\r\n";
    assert_eq!(asked(&site, whoami, wrong).await.refusal(), no(401, "http.wrong_key"));
    for header in [format!("X-Api-Key: {OPERATE}\r\n"), format!("Authorization: Bearer {OPERATE}\r\n")] {
        let good = asked(&site, whoami, &header).await;
        assert_eq!(good.json(), json!({ "name": "slicer", "access": "operate" }));
    }
    // Clients of OctoPrint know 403 alone.
    assert_eq!(asked(&site, "/api/version", "").await.refusal(), no(403, "http.no_key"));
    site.end().await;
}

#[tokio::test]
async fn a_key_allows_what_its_role_does() {
    let site = Site::with(Edge::default(), true).await;
    let look = site.post("/api/v1/keys", json!({ "name": "screen", "access": "view" })).await;
    assert_eq!(look.status, 201);
    let view = format!("X-Api-Key: {}\r\n", look.json()["key"].as_str().unwrap());
    let operate = format!("X-Api-Key: {OPERATE}\r\n");
    assert_eq!(asked(&site, "/api/v1/jobs", &view).await.status, 200);
    let add = |header: &str| request("POST", "/api/v1/jobs", Some(json!({ "path": "/x.gcode" })), header);
    assert_eq!(site.tcp(add(&view).as_bytes()).await.refusal(), no(403, "http.not_allowed"));
    assert_eq!(site.tcp(add(&operate).as_bytes()).await.refusal(), no(403, "http.local_only"));
    assert_eq!(asked(&site, "/api/v1/keys", &operate).await.refusal(), no(403, "http.not_allowed"));
    let command = request("POST", "/api/printer/command", Some(json!({ "command": "M104 S200" })), &operate);
    assert_eq!(site.tcp(command.as_bytes()).await.refusal(), no(403, "http.not_allowed"));
    // Void at once, although it is remembered as good.
    assert_eq!(site.ask("DELETE", "/api/v1/keys/screen", None).await.status, 204);
    assert_eq!(asked(&site, "/api/v1/jobs", &view).await.refusal(), no(401, "http.wrong_key"));
    site.end().await;
}

#[tokio::test]
async fn too_many_wrong_keys_of_an_address_are_refused_and_good_ones_go_on() {
    let site = Site::with(Edge::default(), true).await;
    let operate = format!("X-Api-Key: {OPERATE}\r\n");
    assert_eq!(asked(&site, "/api/v1/whoami", &operate).await.status, 200);
    for _ in 0..10 {
        let wrong = asked(&site, "/api/v1/whoami", "X-Api-Key: 5D1F0E8B93A67C25B0D95E8137AC64F2\r\n").await;
        assert_eq!(wrong.status, 401);
    }
    let refused = asked(&site, "/api/v1/whoami", "X-Api-Key: 6D1F0E8B93A67C25B0D95E8137AC64F2\r\n").await;
    assert_eq!(refused.refusal(), no(429, "http.too_many_wrong_keys"));
    assert!(refused.head.contains("retry-after: "), "{refused:?}");
    assert_eq!(asked(&site, "/api/v1/whoami", &operate).await.status, 200);
    site.end().await;
}

#[tokio::test]
async fn wrong_keys_of_its_address_keep_no_good_key_out_that_was_not_used_before() {
    let site = Site::with(Edge::default(), true).await;
    for _ in 0..20 {
        asked(&site, "/api/v1/whoami", "X-Api-Key: 5D1F0E8B93A67C25B0D95E8137AC64F2\r\n").await;
    }
    let other = asked(&site, "/api/v1/whoami", "X-Api-Key: 6D1F0E8B93A67C25B0D95E8137AC64F2\r\n").await;
    assert_eq!(other.refusal(), no(429, "http.too_many_wrong_keys"));
    let operate = format!("X-Api-Key: {OPERATE}\r\n");
    let good = asked(&site, "/api/v1/whoami", &operate).await;
    assert_eq!(good.status, 200, "{good:?}");
    site.end().await;
}

#[tokio::test]
async fn a_flood_with_one_key_is_refused_and_other_keys_go_on() {
    let dir = tempfile::tempdir().unwrap();
    let keys = Keys::open(&dir.path().join("keys.toml")).unwrap();
    let (busy, calm) = ("4D1F0E8B93A67C25B0D95E8137AC64F2", "7E2A0E8B93A67C25B0D95E8137AC64F2");
    keys.add_given(name("busy"), wire::Access::View, busy).unwrap();
    keys.add_given(name("calm"), wire::Access::View, calm).unwrap();
    let here = "127.0.0.1".parse().unwrap();
    let mut refused = None;
    for _ in 0..100_000 {
        refused = keys.check(busy, here).await.err();
        if refused.is_some() {
            break;
        }
    }
    let refused = refused.expect("so many are a flood");
    assert_eq!((refused.status.as_u16(), refused.code), (429, "http.too_many_requests"));
    assert!(refused.retry_after_s.is_some());
    assert!(keys.check(calm, here).await.is_ok());
}

#[tokio::test]
async fn keys_are_told_once_and_kept_as_hashes_for_their_owner_alone() {
    let site = Site::open().await;
    let new = site.post("/api/v1/keys", json!({ "name": "Prusa Slicer", "access": "operate" })).await.json();
    let key = new["key"].as_str().unwrap().to_owned();
    let path = site.dir.path().join("keys.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("$argon2id$") && !text.contains(&key), "{text}");
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    let listed = site.get("/api/v1/keys").await;
    assert_eq!(listed.json(), json!({ "keys": [{ "name": "Prusa Slicer", "access": "operate" }] }));
    let twice = site.post("/api/v1/keys", json!({ "name": "Prusa Slicer", "access": "view" })).await;
    assert_eq!(twice.refusal(), no(409, "http.key_taken"));
    let again = Keys::open(&path).unwrap();
    let (whose, access) = again.check(&key, "127.0.0.1".parse().unwrap()).await.unwrap();
    assert_eq!((whose.as_str(), access), ("Prusa Slicer", wire::Access::Operate));
    assert_eq!(site.ask("DELETE", "/api/v1/keys/Prusa%20Slicer", None).await.status, 204);
    assert_eq!(site.ask("DELETE", "/api/v1/keys/nobody", None).await.refusal(), no(404, "http.no_such_key"));
    site.end().await;
}

#[test]
fn keys_that_others_can_read_and_weak_ones_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("keys.toml");
    let keys = Keys::open(&path).unwrap();
    let weak = keys.add_given(name("me"), wire::Access::Admin, "password").unwrap_err().to_string();
    assert!(weak.contains("found a key of 8 characters, expected at least 20"), "{weak}");
    assert!(!path.exists());
    keys.add(name("me"), wire::Access::Admin).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o640)).unwrap();
    let open = Keys::open(&path).unwrap_err().to_string();
    assert!(open.contains("found rights 640, expected 600"), "{open}");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    std::fs::write(&path, "key = 1").unwrap();
    assert!(Keys::open(&path).unwrap_err().to_string().contains("mend the file"));
}

#[tokio::test]
async fn tcp_is_served_with_keys_and_on_this_machine_alone() {
    let dir = tempfile::tempdir().unwrap();
    let keys = Keys::open(&dir.path().join("keys.toml")).unwrap();
    let bind = |address: &str| Listen { socket: None, tcp: vec![address.parse().unwrap()] };
    let none = Listeners::bind(&bind("127.0.0.1:0"), &keys).await.unwrap_err();
    assert!(matches!(none, BindError::NoKeys { .. }), "{none}");
    keys.add(name("me"), wire::Access::View).unwrap();
    for open in ["0.0.0.0:0", "[::]:0", "192.0.2.1:0", "[::ffff:192.0.2.1]:0"] {
        let open = Listeners::bind(&bind(open), &keys).await.unwrap_err();
        assert!(matches!(open, BindError::NoTls { .. }), "{open}");
    }
    assert!(Listeners::bind(&bind("127.0.0.1:0"), &keys).await.is_ok());
}
