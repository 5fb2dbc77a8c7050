//! A case over the API, from its image to its job, with the real program and a real queue: what a screen does.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use lumenfab::app::Stage;
use lumenfab::client::{Client, Told};
use lumenfab::http::wire::case::{CaseToQueue, NewCase, StagesBody, TaskState, TaskView};
use serde_json::json;
use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;
use tokio::time::{Instant, sleep};

const PATIENCE: Duration = Duration::from_secs(600);

async fn over(client: &Client, task: &TaskView) -> TaskView {
    let start = Instant::now();
    loop {
        let found = client.task(&task.id).await.unwrap();
        if found.state.is_over() {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "the task does not end: {found:?}");
        sleep(Duration::from_millis(50)).await;
    }
}

#[tokio::test]
async fn a_case_is_begun_corrected_built_sliced_and_queued() {
    let dir = tempfile::tempdir().unwrap();
    let state = dir.path().join("state");
    fs::create_dir(&state).unwrap();
    fs::write(state.join("config.toml"), "[prepare]\nworkers = 0\n").unwrap();
    let mut server = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
        .args(["serve", "--state", "state"])
        .current_dir(dir.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let client = Client::over_socket(state.join("lumenfab.sock"));
    let start = Instant::now();
    while client.health().await.is_err() {
        assert!(start.elapsed() < PATIENCE, "the server does not start");
        sleep(Duration::from_millis(20)).await;
    }
    let mut events = client.events(None);
    assert_eq!(events.next().await.unwrap(), Told::Connected);
    let heard = tokio::spawn(async move {
        loop {
            if let Told::Task(task) = events.next().await.unwrap()
                && task.state.is_over()
            {
                return task;
            }
        }
    });
    let parameters = json!({ "phantom": { "kind": "tube" } });
    let begun = client.begin_case(&NewCase { folder: None, parameters, last: Stage::Segment }).await.unwrap();
    let segmented = over(&client, &begun.task).await;
    assert_eq!(segmented.state, TaskState::Done, "{segmented:?}");
    assert_eq!(*heard.await.unwrap(), segmented);
    let case = client.case(&begun.case).await.unwrap();
    assert!(case.files.iter().any(|file| file == "contours.png"), "{:?}", case.files);
    assert_eq!(case.stages.iter().map(|stage| stage.stage).collect::<Vec<_>>(), [Stage::Segment]);
    assert!(client.case_file(&begun.case, "contours.png").await.unwrap().starts_with(b"\x89PNG"));
    assert!(client.case_file(&begun.case, "../config.toml").await.is_err());
    let built = StagesBody { last: Stage::Slice, parameters: json!({ "wall_mm": 1.2 }) };
    let sliced = over(&client, &client.do_stages(&begun.case, &built).await.unwrap()).await;
    assert_eq!(sliced.state, TaskState::Done, "{sliced:?}");
    let case = client.case(&begun.case).await.unwrap();
    assert_eq!(case.parameters["wall_mm"], 1.2);
    let estimate = case.estimate.unwrap();
    assert!(estimate.print_time_s > 0.0 && estimate.filament_g > 0.0, "{estimate:?}");
    let job = client.queue_case(&begun.case, &CaseToQueue::default()).await.unwrap().job;
    assert_eq!(client.job(job.id).await.unwrap().kind, lumenfab::queue::SpecKind::Case);
    let told =
        serde_json::to_string(&(client.tasks().await.unwrap(), client.cases().await.unwrap())).unwrap();
    assert!(!told.contains(dir.path().to_str().unwrap()), "{told}");
    client.remove_case(&begun.case).await.unwrap();
    assert!(client.cases().await.unwrap().cases.is_empty());
    Command::new("kill").arg(server.id().to_string()).status().unwrap();
    server.wait().unwrap();
}
