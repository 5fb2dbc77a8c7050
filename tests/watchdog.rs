//! The service manager hears that the server lives, whatever its queue waits for: else it would kill prints.

use lumenfab::client::Client;
use lumenfab::http::wire::Said;
use lumenfab::queue::{Name, Reason};
use std::os::unix::net::UnixDatagram;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::time::Duration;
use tokio::time::{Instant, sleep};

const PATIENCE: Duration = Duration::from_secs(120);
/// Clients that want something written.
const N_CLIENTS: usize = 12;

#[tokio::test(flavor = "multi_thread")]
async fn a_server_whose_database_is_locked_says_that_it_lives_and_is_read_from() {
    let dir = tempfile::tempdir().unwrap();
    let manager = UnixDatagram::bind(dir.path().join("notify")).unwrap();
    manager.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    let mut server = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
        .args(["serve", "--state", "state"])
        .current_dir(dir.path())
        .env("NOTIFY_SOCKET", dir.path().join("notify"))
        .env("WATCHDOG_USEC", "1000000")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let n_alive = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&n_alive);
    std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        // Until the test's end takes the socket away.
        while Arc::strong_count(&count) > 1 {
            if let Ok(n_bytes) = manager.recv(&mut bytes) {
                let text = String::from_utf8_lossy(&bytes[..n_bytes]);
                count.fetch_add(u32::from(text.contains("WATCHDOG=1")), Relaxed);
            }
        }
    });
    let client = Client::over_socket(dir.path().join("state/lumenfab.sock"));
    let start = Instant::now();
    while client.health().await.is_err() {
        assert!(start.elapsed() < PATIENCE, "the server does not start");
        sleep(Duration::from_millis(20)).await;
    }
    let lock = rusqlite::Connection::open(dir.path().join("state/queue.db")).unwrap();
    lock.busy_timeout(PATIENCE).unwrap();
    lock.execute_batch("BEGIN IMMEDIATE").unwrap();
    let before = n_alive.load(Relaxed);
    let printer = Name::try_new("printer").unwrap();
    let said = Said { name: None, why: Reason::default() };
    let write = |_| {
        let (client, printer, said) = (client.clone(), printer.clone(), said.clone());
        tokio::spawn(async move { client.doubt_bed(&printer, &said).await })
    };
    let writes: Vec<_> = (0..N_CLIENTS).map(write).collect();
    client.status().await.unwrap();
    assert!(writes.iter().all(|write| !write.is_finished()), "whoever looks has waited for those who write");
    for write in writes {
        assert_eq!(write.await.unwrap().unwrap_err().code(), "store.locked");
    }
    let n_heard = n_alive.load(Relaxed) - before;
    // Twice a second, for the five seconds and more that the first one waits.
    assert!(n_heard >= 4, "it was heard {n_heard} times");
    lock.execute_batch("COMMIT").unwrap();
    client.doubt_bed(&printer, &said).await.unwrap();
    Command::new("kill").arg(server.id().to_string()).status().unwrap();
    assert!(server.wait().unwrap().success());
}
