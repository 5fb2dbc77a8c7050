//! Jobs, printers, plan and history over the own API.

use super::*;

fn path(id: JobId, rest: &str) -> String {
    format!("/api/v1/jobs/{id}{rest}")
}

async fn turn(site: &Site, id: JobId, body: Value) -> Answer {
    site.post(&path(id, "/changes"), body).await
}

#[tokio::test]
async fn a_local_file_becomes_a_job_whose_names_tell_nothing() {
    let site = Site::open().await;
    let id = site.added(false).await;
    let shown = site.get(&path(id, "")).await;
    assert_eq!(
        (shown.status, &shown.json()["state"], &shown.json()["kind"]),
        (200, &json!("draft"), &json!("gcode"))
    );
    assert_eq!(site.files(), [format!("{id}.gcode")]);
    let history = site.get(&path(id, "/history")).await;
    for answer in [&shown, &history] {
        assert!(!answer.body.contains("MEIER"), "{answer:?}");
    }
    assert_eq!(site.get("/api/v1/jobs").await.json()["jobs"][0]["id"], json!(id));
    site.end().await;
}

#[tokio::test]
async fn the_same_id_again_adds_nothing_and_another_file_under_it_is_refused() {
    let site = Site::open().await;
    let id = site.app.new_id().unwrap();
    let body = json!({ "path": site.local_file(), "id": id });
    for _ in 0..2 {
        let added = site.post("/api/v1/jobs", body.clone()).await;
        assert_eq!((added.status, &added.json()["id"]), (201, &json!(id)));
    }
    let other = site.dir.path().join("other.gcode");
    std::fs::write(&other, "G28 X\n").unwrap();
    let refused = site.post("/api/v1/jobs", json!({ "path": other, "id": id })).await;
    assert_eq!(refused.refusal(), no(409, "queue.id_taken"));
    let kept = std::fs::read_to_string(site.dir.path().join(format!("files/{id}.gcode"))).unwrap();
    assert_eq!((kept.as_str(), site.files().len()), ("G28\nG1 X1 E1\n", 1));
    site.end().await;
}

#[tokio::test]
async fn a_case_is_linked_to_and_other_folders_are_refused() {
    let site = Site::open().await;
    let case = site.dir.path().join("MEIER");
    std::fs::create_dir(&case).unwrap();
    let refused = site.post("/api/v1/jobs", json!({ "path": case })).await;
    assert_eq!((refused.refusal(), site.files().len()), (no(400, "http.no_case"), 0));
    std::fs::write(case.join("case.toml"), "").unwrap();
    let added = site.post("/api/v1/jobs", json!({ "path": case })).await;
    assert_eq!((added.status, &added.json()["kind"]), (201, &json!("case")));
    assert!(!added.body.contains("MEIER"));
    let link = site.dir.path().join("files").join(&site.files()[0]);
    assert_eq!(std::fs::read_link(link).unwrap(), case);
    site.end().await;
}

#[tokio::test]
async fn local_files_that_cannot_be_are_refused_by_code() {
    let site = Site::open().await;
    for (path, code) in [
        ("job.gcode", no(400, "http.bad_name")),
        ("/nowhere/job.gcode", no(400, "http.unreadable")),
        ("/etc/passwd", no(415, "http.unknown_kind")),
    ] {
        let refused = site.post("/api/v1/jobs", json!({ "path": path })).await;
        assert_eq!(refused.refusal(), code, "{path}");
        assert!(!refused.body.contains("nowhere"));
    }
    let no_copies = json!({ "path": site.local_file(), "wishes": { "copies": 0 } });
    assert_eq!(site.post("/api/v1/jobs", no_copies).await.refusal(), no(422, "queue.copies"));
    let misspelt = json!({ "path": site.local_file(), "wishes": { "copiez": 2 } });
    assert_eq!(site.post("/api/v1/jobs", misspelt).await.refusal(), no(422, "http.malformed"));
    assert_eq!(site.files(), [""; 0]);
    site.end().await;
}

#[tokio::test]
async fn a_job_is_submitted_held_released_edited_moved_and_called_off() {
    let site = Site::open().await;
    let (a, b) = (site.added(false).await, site.added(true).await);
    for (asked, state) in [("submit", "queued"), ("hold", "held"), ("release", "queued")] {
        let done = turn(&site, a, json!({ "turn": asked, "why": "so" })).await;
        assert_eq!((done.status, &done.json()["state"]), (200, &json!(state)), "{asked}");
    }
    let edits = [
        (json!({ "copies": 3 }), "copies", json!(3)),
        (json!({ "priority": -2 }), "priority", json!(-2)),
        (
            json!({ "not-before": { "at": "2027-01-01T08:00:00Z" } }),
            "not_before",
            json!("2027-01-01T08:00:00Z"),
        ),
        (json!({ "not-before": { "at": null } }), "not_before", Value::Null),
    ];
    for (edit, field, value) in edits {
        let done = turn(&site, a, json!({ "turn": edit })).await;
        assert_eq!((done.status, &done.json()[field]), (200, &value), "{edit}");
    }
    let first = || async { site.get("/api/v1/jobs?most=1").await.json() };
    assert_eq!(
        (first().await["jobs"][0]["id"].clone(), first().await["more"].clone()),
        (json!(b), json!(true))
    );
    assert_eq!(turn(&site, a, json!({ "turn": { "priority": 0 } })).await.status, 200);
    assert_eq!(turn(&site, a, json!({ "turn": { "move": { "before": b } } })).await.status, 200);
    assert_eq!(first().await["jobs"][0]["id"], json!(a));
    let behind = site.get(&format!("/api/v1/jobs?behind={a}")).await.json();
    assert_eq!((&behind["jobs"][0]["id"], &behind["more"]), (&json!(b), &json!(false)));
    assert_eq!(turn(&site, a, json!({ "turn": "cancel" })).await.json()["state"], "cancelled");
    assert_eq!(site.get("/api/v1/jobs?which=over").await.json()["jobs"][0]["id"], json!(a));
    assert_eq!(turn(&site, a, json!({ "turn": "retry" })).await.json()["state"], "queued");
    site.end().await;
}

#[tokio::test]
async fn what_the_queue_refuses_is_told_with_its_code() {
    let site = Site::open().await;
    let id = site.added(false).await;
    for (body, expected) in [
        (json!({ "turn": "hold" }), no(409, "queue.not_in_state")),
        (json!({ "turn": "submit", "saw": "held" }), no(409, "queue.changed_meanwhile")),
        (json!({ "turn": { "copies": 0 } }), no(422, "queue.copies")),
        (json!({ "turn": "pause" }), no(409, "http.not_printing")),
        (json!({ "turn": "accept", "why": "good" }), no(422, "http.no_name")),
        (json!({ "turn": "dance" }), no(422, "http.malformed")),
        (json!({ "turn": "hold", "wy": "x" }), no(422, "http.malformed")),
        (json!({ "turn": { "move": { "before": site.app.new_id().unwrap() } } }), no(404, "queue.no_job")),
    ] {
        assert_eq!(turn(&site, id, body.clone()).await.refusal(), expected, "{body}");
    }
    let none = site.app.new_id().unwrap();
    for gone in [
        path(none, ""),
        path(none, "/history"),
        "/api/v1/jobs/x".into(),
        format!("/api/v1/jobs?behind={none}"),
    ] {
        assert_eq!(site.get(&gone).await.refusal(), no(404, "queue.no_job"), "{gone}");
    }
    assert_eq!(site.get("/api/v1/jobs?which=none").await.refusal(), no(400, "http.malformed"));
    assert_eq!(site.get("/nothing").await.refusal(), no(404, "http.not_found"));
    assert_eq!(site.ask("PATCH", "/api/v1/jobs", None).await.refusal(), no(405, "http.no_method"));
    assert_eq!(site.get(&path(id, "")).await.json()["revision"], 0);
    site.end().await;
}

#[tokio::test]
async fn a_printer_that_has_a_job_in_hand_is_asked_to_stop_it() {
    let site = Site::open().await;
    let (id, _claimed) = site.in_print().await;
    for (asked, wish) in [("pause", "Pause"), ("cancel", "Cancel")] {
        let done = turn(&site, id, json!({ "turn": asked, "name": "Ada" })).await;
        assert_eq!((done.status, &done.json()["state"]), (202, &json!("printing")));
        let last = site.asked.lock().unwrap().last().cloned().unwrap();
        assert!(last.starts_with(&format!("{wish} by Ada (by ")), "{last}");
    }
    assert_eq!(
        turn(&site, id, json!({ "turn": "cancel", "saw": "queued" })).await.refusal(),
        no(409, "queue.changed_meanwhile")
    );
    site.end().await;
}

#[tokio::test]
async fn a_printer_of_this_server_is_asked_whatever_the_clock_says_of_its_claim() {
    let site = Site::open().await;
    let (id, _claimed) = site.in_print().await;
    let db = rusqlite::Connection::open(site.dir.path().join("queue.db")).unwrap();
    assert_eq!(db.execute("UPDATE claims SET until_ms = 0", []).unwrap(), 1);
    assert_eq!(turn(&site, id, json!({ "turn": "pause" })).await.refusal(), no(409, "http.not_printing"));
    site.lives.send_replace(vec![Live { job: Some(id), ..idle() }]);
    for asked in ["pause", "cancel"] {
        let done = turn(&site, id, json!({ "turn": asked })).await;
        assert_eq!((done.status, &done.json()["state"]), (202, &json!("printing")));
    }
    site.lives.send_replace(vec![idle()]);
    assert_eq!(turn(&site, id, json!({ "turn": "cancel" })).await.json()["state"], "cancelled");
    site.end().await;
}

#[tokio::test]
async fn a_bed_is_cleared_only_by_naming_what_lies_on_it() {
    let site = Site::open().await;
    let (id, claimed) = site.in_print().await;
    let clear = "/api/v1/printers/left/bed-clear";
    assert_eq!(site.post(clear, json!({ "on_bed": id })).await.refusal(), no(409, "queue.bed_in_use"));
    site.printed(id, claimed).await;
    let other = site.app.new_id().unwrap();
    assert_eq!(site.post(clear, json!({ "on_bed": other })).await.refusal(), no(409, "http.other_bed"));
    assert_eq!(site.post(clear, json!({ "on_bed": null })).await.refusal(), no(409, "http.other_bed"));
    assert_eq!(site.post(clear, json!({})).await.refusal(), no(422, "http.malformed"));
    assert_eq!(site.get(&path(id, "")).await.json()["state"], "awaiting-bed-clear");
    let cleared = site.post(clear, json!({ "on_bed": id, "name": "Ada", "why": "part taken off" })).await;
    assert_eq!((cleared.status, &cleared.json()["bed"]), (200, &json!("clear")));
    assert_eq!(site.get(&path(id, "")).await.json()["state"], "finished");
    let records = site.get("/api/v1/printers/left/history").await.json();
    let last = records["records"].as_array().unwrap().last().unwrap().clone();
    assert!(last["who"].as_str().unwrap().starts_with("Ada (by "), "{last}");
    assert_eq!(last["why"], "part taken off");
    let unknown = site.post("/api/v1/printers/right/bed-clear", json!({ "on_bed": null })).await;
    assert_eq!(unknown.refusal(), no(404, "queue.no_printer"));
    site.end().await;
}

#[tokio::test]
async fn a_report_is_signed_off_by_name_and_reason() {
    for (verdict, state) in [("accept", "finished"), ("reject", "failed")] {
        let site = Site::open().await;
        let (id, claimed) = site.in_print_with(json!({ "sign_off": true })).await;
        site.printed(id, claimed).await;
        let cleared = site.post("/api/v1/printers/left/bed-clear", json!({ "on_bed": id })).await;
        assert_eq!(cleared.status, 200);
        assert_eq!(site.get(&path(id, "")).await.json()["state"], "awaiting-sign-off");
        let no_name = turn(&site, id, json!({ "turn": verdict, "why": "0.1 mm" })).await;
        assert_eq!(no_name.refusal(), no(422, "http.no_name"));
        let no_reason = turn(&site, id, json!({ "turn": verdict, "name": "Ada" })).await;
        assert_eq!(no_reason.refusal(), no(422, "queue.no_reason"));
        let done = turn(&site, id, json!({ "turn": verdict, "name": "Ada", "why": "0.1 mm" })).await;
        assert_eq!((done.status, &done.json()["state"]), (200, &json!(state)));
        let history = site.get(&path(id, "/history")).await.json();
        let last = history["records"].as_array().unwrap().last().unwrap().clone();
        assert!(last["who"].as_str().unwrap().starts_with("Ada (by "), "{last}");
        assert_eq!(last["why"], "0.1 mm");
        site.end().await;
    }
}

#[tokio::test]
async fn printers_are_made_known_and_doubted() {
    let site = Site::open().await;
    assert_eq!(site.get("/api/v1/printers").await.json()["printers"][0]["loaded"], Value::Null);
    let loaded = json!({ "profile": "marlin", "material": "pla", "nozzle_um": 400, "left_mm3": 90000 });
    let told = site.ask("PUT", "/api/v1/printers/left/loaded", Some(loaded)).await.json();
    assert_eq!((&told["loaded"]["material"], &told["bed"]), (&json!("PLA"), &json!("unknown")));
    let clear = site.post("/api/v1/printers/left/bed-clear", json!({ "on_bed": null })).await;
    assert_eq!(clear.json()["bed"], "clear");
    let doubt = site.post("/api/v1/printers/left/bed-in-doubt", json!({ "why": "door was open" })).await;
    assert_eq!(doubt.json()["bed"], "unknown");
    assert_eq!(site.get("/api/v1/printers/left").await.json()["live"]["activity"], "idle");
    assert_eq!(site.get("/api/v1/printers/right").await.refusal(), no(404, "queue.no_printer"));
    site.end().await;
}

#[tokio::test]
async fn the_plan_tells_what_is_next_and_why_nothing_is() {
    let site = Site::open().await;
    let (id, _claimed) = site.in_print().await;
    let waiting = site.added(true).await;
    let plan = site.get("/api/v1/schedule").await.json();
    assert_eq!((&plan["next"][0]["job"], &plan["slots"][0]["job"]), (&Value::Null, &json!(id)));
    assert!(plan["next"][0]["why_not"].as_str().unwrap().contains("is printing job"), "{plan}");
    assert_eq!(plan["unplanned"][0]["job"], json!(waiting));
    assert_eq!(plan["unplanned"][0]["why"], "how long it takes is known once it is prepared");
    assert!(plan["ends_words"].as_str().unwrap().starts_with("the last job ends "), "{plan}");
    assert_eq!(plan["is_cut"], false);
    site.end().await;
}

#[tokio::test]
async fn history_goes_on_where_it_ended() {
    let site = Site::open().await;
    site.added(true).await;
    let page = site.get("/api/v1/history?most=1").await.json();
    assert_eq!((&page["records"][0]["seq"], &page["more"]), (&json!(1), &json!(true)));
    let rest = site.get("/api/v1/history?after=1").await.json();
    assert_eq!((&rest["records"][0]["seq"], &rest["more"]), (&json!(2), &json!(false)));
    site.end().await;
}

#[tokio::test]
async fn the_server_tells_of_itself_and_of_whoever_asks() {
    let site = Site::open().await;
    let status = site.get("/api/v1/status").await.json();
    assert_eq!((&status["api"], &status["version"]), (&json!(1), &json!(env!("CARGO_PKG_VERSION"))));
    assert_eq!(site.get("/api/v1/health").await.json(), json!({ "ok": true }));
    assert_eq!(site.get("/api/v1/whoami").await.json()["access"], "admin");
    site.end().await;
}

#[tokio::test]
async fn a_closed_queue_is_told_without_its_path() {
    let site = Site::open().await;
    assert_eq!(site.get("/api/v1/health").await.status, 200);
    site.app.store.clone().close().await;
    let refused = site.get("/api/v1/health").await;
    assert_eq!(refused.refusal(), no(503, "store.gone"));
    assert!(refused.head.contains("retry-after: 5"), "{refused:?}");
    assert!(!refused.body.contains("queue.db"));
    site.end().await;
}

#[tokio::test]
async fn orders_reach_the_printer_that_is_named() {
    let site = Site::open().await;
    let orders = "/api/v1/printers/left/orders";
    let given = [
        (json!({ "order": "emergency-stop", "name": "Ada" }), "EmergencyStop by Ada (by"),
        (json!({ "order": { "commands": ["G28 X", "M106"] } }), "Commands([\"G28 X\", \"M106\"]) by"),
        (json!({ "order": "connect" }), "Connect by"),
        (json!({ "order": "disconnect" }), "Disconnect by"),
    ];
    for (body, asked) in given {
        assert_eq!(site.post(orders, body).await.status, 202);
        let last = site.asked.lock().unwrap().last().cloned().unwrap();
        assert!(last.starts_with(asked), "{last}");
    }
    for bad in [json!([]), json!(["G28\nM104 S250"]), json!(["x".repeat(97)])] {
        let answer = site.post(orders, json!({ "order": { "commands": bad } })).await;
        assert_eq!(answer.refusal(), no(400, "http.bad_command"));
    }
    let other = site.post("/api/v1/printers/right/orders", json!({ "order": "connect" })).await;
    assert_eq!(other.refusal(), no(404, "queue.no_printer"));
    site.end().await;
}
