//! Folders, tasks and cases, with a program that stands in for this one.

use super::*;
use crate::app::Stage;
use crate::app::volume_file;
use crate::client::Client;
use crate::ct::{Volume, Voxels};
use crate::geom::RigidTransform;
use crate::http::wire::case::{
    FolderPath, Handle, NewCase, SeriesBody, StagesBody, TaskKind, TaskState, TaskView,
};
use std::os::unix::fs::PermissionsExt;

/// A server with a folder of a patient; what its child does: `$line` is the errand.
async fn site(script: &str) -> (Site, Client, Handle) {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(dir.path().join("ct/MEIER JOSEF")).unwrap();
    let program = dir.path().join("program");
    std::fs::write(&program, format!("#!/bin/sh\nread -r line\n{script}\n")).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let site = Site::within(dir, Edge::default(), true).await;
    let client = Client::over_socket(&site.socket);
    let root = client.folders(None).await.unwrap().folders.remove(0);
    let folder = client.folders(Some(&root.id)).await.unwrap().folders.remove(0).id;
    (site, client, folder)
}

async fn over(client: &Client, task: &TaskView) -> TaskView {
    for _ in 0..2000 {
        let found = client.task(&task.id).await.unwrap();
        if found.state.is_over() {
            return found;
        }
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    panic!("the task does not end: {:?}", client.task(&task.id).await);
}

#[tokio::test]
async fn a_series_is_found_and_its_planes_are_pictures_and_no_name_goes_out() {
    let script = "to=$(printf %s \"$line\" | sed 's/.*\"to\":\"\\([^\"]*\\)\".*/\\1/')\n\
        case \"$line\" in *planes*) cp \"$0.bin\" \"$to\";; *MEIER*) ;; *) exit 1;; esac\n\
        echo '{\"event\":\"progress\",\"done\":1,\"total\":2}'\n\
        echo '{\"event\":\"done\",\"result\":{\"n_files\":7}}'";
    let (site, client, folder) = site(script).await;
    let volume = Volume {
        dims: [3, 2, 2],
        hu: Voxels::new(&[100.0; 12], 6),
        origin_xy_mm: [0.0; 2],
        pixel_spacing_xy_mm: [0.5; 2],
        plane_z_mm: vec![0.0, 1.0],
        slab_thickness_mm: 1.0,
        patient_from_stack: RigidTransform::identity(),
    };
    std::fs::write(site.dir.path().join("program.bin"), volume_file::to_bytes(&volume)).unwrap();
    let inspected = over(&client, &client.inspect(&folder).await.unwrap()).await;
    assert_eq!((inspected.state, inspected.progress), (TaskState::Done, Some([1, 2])));
    assert_eq!(inspected.result.unwrap()["n_files"], 7);
    let mut volumes = Vec::new();
    for _ in 0..3 {
        let read = over(&client, &client.read_volume(&folder, &SeriesBody::default()).await.unwrap()).await;
        assert_eq!(read.state, TaskState::Done, "{read:?}");
        let view: wire::case::VolumeView =
            serde_json::from_value(read.result.unwrap()["volume"].clone()).unwrap();
        assert_eq!((view.dims, view.plane_z_mm), ([3, 2, 2], vec![0.0, 1.0]));
        volumes.push(view.id);
    }
    let png = client.plane(&volumes[2], ('z', 1), [0.0, 200.0]).await.unwrap();
    assert!(png.starts_with(b"\x89PNG"));
    let refused = client.plane(&volumes[2], ('z', 2), [0.0, 200.0]).await.unwrap_err();
    assert!(refused.to_string().contains("found plane 2, expected one from 0 to 1"), "{refused}");
    assert!(client.plane(&volumes[2], ('z', 0), [5.0, 5.0]).await.is_err());
    assert!(client.volume(&volumes[0]).await.is_err(), "only the last ones are kept");
    let told = serde_json::to_string(&client.tasks().await.unwrap()).unwrap();
    assert!(!told.contains("MEIER") && !told.contains("/ct"), "{told}");
    site.end().await;
}

#[tokio::test]
async fn what_a_case_is_made_with_is_checked_and_what_goes_wrong_is_told() {
    let script = "case \"$line\" in *MEIER*seed*|*MEIER*wall*) ;; *) exit 1;; esac\n\
        echo '{\"event\":\"started\",\"stage\":\"segment\"}'\n\
        echo '{\"event\":\"warned\",\"code\":\"a.b\",\"text\":\"odd\"}'\n\
        echo '{\"event\":\"failed\",\"code\":\"segment.leak\",\"text\":\"it leaks\"}'";
    let (site, client, folder) = site(script).await;
    let new = |folder: Option<&Handle>, parameters: Value, last| NewCase {
        folder: folder.cloned(),
        parameters,
        last,
    };
    let wrong = [
        (json!({ "ct": "/etc" }), "http.bad_parameter"),
        (json!({ "port": "/dev/ttyACM0" }), "http.bad_parameter"),
        (json!({ "profile": "/etc/passwd" }), "http.bad_parameter"),
        (json!({ "series": "1.2.840.1" }), "http.bad_parameter"),
        (json!({ "colour": "red" }), "http.bad_parameter"),
    ];
    for (parameters, code) in wrong {
        let refused =
            client.begin_case(&new(Some(&folder), parameters.clone(), Stage::Segment)).await.unwrap_err();
        assert_eq!(refused.code(), code, "{parameters}: {refused}");
        assert!(!refused.to_string().contains("/etc"), "{refused}");
    }
    let no_ct = client.begin_case(&new(None, Value::Null, Stage::Segment)).await.unwrap_err();
    assert_eq!(no_ct.code(), "http.no_ct");
    let print = client.begin_case(&new(Some(&folder), json!({ "seed_mm": "auto" }), Stage::Print)).await;
    assert_eq!(print.unwrap_err().code(), "http.not_a_stage");
    let begun =
        client.begin_case(&new(Some(&folder), json!({ "seed_mm": "auto" }), Stage::Solid)).await.unwrap();
    let failed = over(&client, &begun.task).await;
    assert_eq!(
        (failed.state, failed.kind, failed.stage),
        (TaskState::Failed, TaskKind::Stages, Some(Stage::Segment))
    );
    assert_eq!(failed.fault.unwrap().code, "segment.leak");
    assert_eq!(failed.warnings[0].code, "a.b");
    let gone = client.case(&begun.case).await.unwrap_err();
    assert_eq!(gone.code(), "http.not_found");
    let stages = StagesBody { last: Stage::Solid, parameters: Value::Null };
    assert_eq!(client.do_stages(&begun.case, &stages).await.unwrap_err().code(), "http.not_found");
    assert!(client.cases().await.unwrap().cases.is_empty());
    // A child that says nothing.
    let died = over(&client, &client.inspect(&folder).await.unwrap()).await;
    assert_eq!(died.fault.unwrap().code, "http.task_died");
    site.end().await;
}

#[tokio::test]
async fn a_task_is_cancelled_and_the_next_one_has_its_turn() {
    let script =
        "case \"$line\" in *inspect*) exec sleep 60;; esac\necho '{\"event\":\"done\",\"result\":{}}'";
    let (site, client, folder) = site(script).await;
    let long = client.inspect(&folder).await.unwrap();
    let new =
        NewCase { folder: Some(folder), parameters: json!({ "seed_mm": "auto" }), last: Stage::Segment };
    let next = client.begin_case(&new).await.unwrap();
    assert_eq!(client.task(&next.task.id).await.unwrap().state, TaskState::Waiting);
    client.cancel_task(&long.id).await.unwrap();
    assert_eq!(over(&client, &long).await.state, TaskState::Cancelled);
    assert_eq!(over(&client, &next.task).await.state, TaskState::Done);
    site.end().await;
}

#[tokio::test]
async fn folders_and_pixels_are_for_operators_and_paths_for_the_socket_alone() {
    let (site, client, _folder) = site("").await;
    let key = client
        .add_key(&wire::KeyBody { name: name("screen"), access: wire::Access::View })
        .await
        .unwrap()
        .key;
    let address = site.tcp.unwrap();
    let (viewer, operator) = (Client::over_tcp(address, key), Client::over_tcp(address, access::OPERATE));
    assert_eq!(viewer.folders(None).await.unwrap_err().code(), "http.not_allowed");
    assert!(viewer.tasks().await.is_ok() && viewer.cases().await.is_ok());
    assert!(operator.folders(None).await.is_ok());
    let path = FolderPath { path: site.dir.path().join("ct").display().to_string() };
    assert_eq!(operator.find_folder(&path).await.unwrap_err().code(), "http.local_only");
    assert!(client.find_folder(&path).await.is_ok());
    let outside = client.find_folder(&FolderPath { path: "/etc".into() }).await.unwrap_err();
    assert_eq!(outside.code(), "http.outside");
    site.end().await;
}
