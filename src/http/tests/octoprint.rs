//! What slicers and apps that know OctoPrint ask for.

use super::*;

async fn get(site: &Site, path: &str) -> Value {
    let answer = site.get(path).await;
    assert_eq!(answer.status, 200, "{path}: {answer:?}");
    answer.json()
}

#[tokio::test]
async fn the_test_button_of_prusaslicer_finds_an_octoprint() {
    let site = Site::open().await;
    let version = get(&site, "/api/version").await;
    assert_eq!(version["api"], "0.1");
    assert!(version["text"].as_str().unwrap().starts_with("OctoPrint"), "{version}");
    assert!(version["server"].as_str().unwrap().split('.').count() == 3);
    assert_eq!(get(&site, "/api/server").await["safemode"], Value::Null);
    site.end().await;
}

#[tokio::test]
async fn apps_find_what_they_look_at_first() {
    let site = Site::open().await;
    let login = site.post("/api/login", json!({ "passive": true })).await.json();
    assert_eq!(
        (&login["active"], &login["admin"], &login["user"]),
        (&json!(true), &json!(true), &json!(true))
    );
    assert!(
        get(&site, "/api/currentuser").await["permissions"].as_array().unwrap().contains(&json!("PRINT"))
    );
    let settings = get(&site, "/api/settings").await;
    for part in ["api", "appearance", "feature", "plugins", "temperature", "webcam"] {
        assert!(settings[part].is_object(), "{part}");
    }
    assert_eq!(get(&site, "/api/printerprofiles").await["profiles"]["_default"]["current"], true);
    let connection = get(&site, "/api/connection").await;
    let current = json!({
        "state": "Operational", "port": "/dev/ttyACM0", "baudrate": 250_000, "printerProfile": "_default",
    });
    assert_eq!(
        (&connection["current"], &connection["options"]["ports"]),
        (&current, &json!(["/dev/ttyACM0"]))
    );
    assert_eq!(site.post("/api/logout", json!({})).await.status, 204);
    site.end().await;
}

#[tokio::test]
async fn the_printer_is_shown_in_octoprints_words() {
    let site = Site::open().await;
    let printer = get(&site, "/api/printer?exclude=sd").await;
    let heat = json!({ "actual": 21.5, "target": 0.0, "offset": 0 });
    assert_eq!((&printer["temperature"]["tool0"], &printer["temperature"]["bed"]), (&heat, &heat));
    assert_eq!(printer["state"]["text"], "Operational");
    let flags = &printer["state"]["flags"];
    for (flag, is_set) in
        [("operational", true), ("ready", true), ("printing", false), ("paused", false), ("error", false)]
    {
        assert_eq!(flags[flag], is_set, "{flag}");
    }
    let (_id, _claimed) = site.in_print().await;
    let job = get(&site, "/api/job").await;
    assert_eq!(
        (&job["job"]["estimatedPrintTime"], &job["job"]["file"]["origin"]),
        (&json!(3600), &json!("local"))
    );
    assert_eq!(job["job"]["file"]["size"], 13);
    site.end().await;
}

#[tokio::test]
async fn a_printer_that_is_off_is_told_as_octoprint_does() {
    let site = Site::open().await;
    for (lives, code) in [
        (vec![], "http.no_printer"),
        (vec![Live::offline(name("left"))], "http.not_operational"),
        (vec![Live { activity: wire::Activity::Faulted, ..idle() }], "http.not_operational"),
    ] {
        site.lives.send_replace(lives);
        assert_eq!(site.get("/api/printer").await.refusal(), no(409, code));
        assert_eq!(get(&site, "/api/job").await["job"]["file"]["name"], Value::Null);
        let command = site.post("/api/printer/command", json!({ "command": "M106" })).await;
        assert_eq!(command.refusal(), no(409, code));
    }
    assert_eq!(get(&site, "/api/job").await["state"], "Error");
    site.lives.send_replace(vec![Live { activity: wire::Activity::Paused, ..idle() }]);
    let printer = get(&site, "/api/printer").await;
    assert_eq!(
        (&printer["state"]["text"], &printer["state"]["flags"]["paused"]),
        (&json!("Paused"), &json!(true))
    );
    let busy = site.post("/api/printer/command", json!({ "command": "M106" })).await;
    assert_eq!(busy.refusal(), no(409, "http.in_print"));
    site.end().await;
}

#[tokio::test]
async fn files_are_jobs() {
    let site = Site::open().await;
    let id = site.added(false).await;
    let files = get(&site, "/api/files?recursive=true").await;
    let file = &files["files"][0];
    let name = format!("{id}.gcode");
    assert_eq!(
        (&file["name"], &file["size"], &file["type"]),
        (&json!(name), &json!(13), &json!("machinecode"))
    );
    assert!(files["free"].as_u64().unwrap() > 0);
    assert_eq!(get(&site, "/api/files/local").await["files"][0]["name"], json!(name));
    let one = format!("/api/files/local/{name}");
    assert_eq!(get(&site, &one).await["origin"], "local");
    let job = || async { site.get(&format!("/api/v1/jobs/{id}")).await.json()["state"].clone() };
    assert_eq!(site.post(&one, json!({ "command": "select" })).await.status, 204);
    assert_eq!(job().await, "draft");
    assert_eq!(site.post("/api/job", json!({ "command": "start" })).await.status, 204);
    assert_eq!(job().await, "queued");
    assert_eq!(site.ask("DELETE", &one, None).await.status, 204);
    assert_eq!(job().await, "cancelled");
    assert_eq!(site.post(&one, json!({ "command": "select", "print": true })).await.status, 204);
    assert_eq!(job().await, "queued");
    assert_eq!(site.get("/api/files/local/none.gcode").await.refusal(), no(404, "http.not_found"));
    assert_eq!(site.post(&one, json!({ "command": "slice" })).await.refusal(), no(422, "http.malformed"));
    site.end().await;
}

#[tokio::test]
async fn job_commands_reach_the_printer_that_prints() {
    let site = Site::open().await;
    for (body, code) in [
        (json!({ "command": "cancel" }), "http.not_printing"),
        (json!({ "command": "pause" }), "http.not_printing"),
        (json!({ "command": "start" }), "http.nothing_selected"),
        (json!({ "command": "restart" }), "http.no_restart"),
    ] {
        assert_eq!(site.post("/api/job", body.clone()).await.refusal(), no(409, code), "{body}");
    }
    let (id, _claimed) = site.in_print().await;
    assert_eq!(site.post("/api/job", json!({ "command": "pause", "action": "resume" })).await.status, 204);
    assert_eq!(site.asked.lock().unwrap().len(), 0, "it prints already");
    for (body, wish) in [
        (json!({ "command": "pause", "action": "pause" }), "Pause"),
        (json!({ "command": "pause" }), "Pause"),
        (json!({ "command": "cancel" }), "Cancel"),
    ] {
        assert_eq!(site.post("/api/job", body).await.status, 204);
        assert!(site.asked.lock().unwrap().last().unwrap().starts_with(wish));
    }
    let file = format!("/api/files/local/{id}.gcode");
    assert_eq!(site.ask("DELETE", &file, None).await.refusal(), no(409, "http.in_print"));
    assert_eq!(
        site.post(&file, json!({ "command": "select", "print": true })).await.refusal(),
        no(409, "queue.not_in_state")
    );
    site.end().await;
}

#[tokio::test]
async fn commands_and_connection_are_passed_on() {
    let site = Site::open().await;
    for body in [json!({ "command": "M106" }), json!({ "commands": ["M18", "M106 S0"] })] {
        assert_eq!(site.post("/api/printer/command", body).await.status, 204);
    }
    for bad in [json!({}), json!({ "command": "G28\nM104 S250" }), json!({ "command": "x".repeat(97) })] {
        assert_eq!(site.post("/api/printer/command", bad).await.refusal(), no(400, "http.bad_command"));
    }
    for command in ["connect", "disconnect"] {
        assert_eq!(
            site.post("/api/connection", json!({ "command": command, "port": "x" })).await.status,
            204
        );
    }
    assert_eq!(
        site.post("/api/connection", json!({ "command": "fake_ack" })).await.refusal(),
        no(400, "http.no_fake_ack")
    );
    let wishes: Vec<_> =
        site.asked.lock().unwrap().iter().map(|a| a.split(" by ").next().unwrap().to_owned()).collect();
    assert_eq!(wishes, ["Commands([\"M106\"])", "Commands([\"M18\", \"M106 S0\"])", "Connect", "Disconnect"]);
    site.end().await;
}
