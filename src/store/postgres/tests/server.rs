//! A PostgreSQL server of the tests' own, from the system's packages: no network, its files gone when the tests end.

use postgres::{Client, NoTls};
use std::fs;
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{LazyLock, Mutex};
use std::time::Duration;

/// Where Debian and others put the server's programs.
const PLACES: [&str; 3] = ["/usr/lib/postgresql", "/usr/local/pgsql", "/usr/pgsql"];
/// Beside each queue: the folder of the server's socket.
const SOCKET_FILE: &str = "socket";

/// How often a server that starts is asked whether it answers, with a pause after each time.
const MOST_TRIES: usize = 1200;

/// The server of this process, for all its tests; why there is none, where it cannot be had.
static SERVER: LazyLock<Result<Server, String>> = LazyLock::new(Server::start);

/// A server; it ends with this process, whatever ends that.
struct Server {
    socket: PathBuf,
    /// A shell that waits for the end of its input, and then ends the server.
    _keeper: Mutex<Child>,
}

impl Server {
    fn start() -> Result<Self, String> {
        let programs = programs().ok_or("no PostgreSQL server is installed (Debian: postgresql)")?;
        let user = account()?;
        let folder = tempfile::Builder::new().prefix("lf-pg-").tempdir().map_err(|e| e.to_string())?.keep();
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o711)).map_err(|e| e.to_string())?;
        let data = folder.join("data");
        if let Some((uid, gid)) = user {
            chown(&folder, Some(uid), Some(gid)).map_err(|e| e.to_string())?;
        }
        let made = as_user(
            Command::new(programs.join("initdb")).args([
                "--auth=trust",
                "--no-sync",
                "-U",
                "lumenfab",
                "-E",
                "UTF8",
                "--locale=C",
                "-D",
            ]),
            user,
        )
        .arg(&data)
        .current_dir(&folder)
        .output()
        .map_err(|e| e.to_string())?;
        if !made.status.success() {
            return Err(String::from_utf8_lossy(&made.stderr).trim().to_owned());
        }
        let script = "\"$1\" -D \"$2\" -k \"$3\" -c listen_addresses= -c fsync=off -c full_page_writes=off -c max_connections=200 \
             >/dev/null 2>&1 & server=$!; cat >/dev/null; kill -QUIT $server; wait; rm -rf \"$3\"";
        let keeper = as_user(Command::new("sh").args(["-c", script, "sh"]), user)
            .args([programs.join("postgres"), data, folder.clone()])
            .current_dir(&folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|e| e.to_string())?;
        let server = Self { socket: folder, _keeper: Mutex::new(keeper) };
        let answers = || Client::connect(&address(&server.socket, "postgres"), NoTls).is_ok();
        if (0..MOST_TRIES).any(|_| answers() || pause()) {
            return Ok(server);
        }
        Err("the server did not answer within a minute".into())
    }
}

/// Waits a little; it is never enough by itself.
#[expect(clippy::disallowed_methods, reason = "nothing tells when a server is ready but asking it")]
fn pause() -> bool {
    std::thread::sleep(Duration::from_millis(50));
    false
}

/// The newest server's programs.
fn programs() -> Option<PathBuf> {
    let versions = PLACES.iter().filter_map(|place| fs::read_dir(place).ok()).flatten().flatten();
    let mut bins: Vec<PathBuf> = versions.map(|version| version.path().join("bin")).collect();
    bins.extend(PLACES.iter().map(|place| Path::new(place).join("bin")));
    bins.extend(std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()));
    bins.retain(|bin| bin.join("initdb").exists() && bin.join("postgres").exists());
    bins.into_iter().max()
}

/// Which account has to run the server: it refuses to be root.
fn account() -> Result<Option<(u32, u32)>, String> {
    if !rustix::process::geteuid().is_root() {
        return Ok(None);
    }
    let users = fs::read_to_string("/etc/passwd").map_err(|e| e.to_string())?;
    let of = |name: &str| {
        let line = users.lines().find(|line| line.split(':').next() == Some(name))?;
        let mut fields = line.split(':').skip(2);
        Some((fields.next()?.parse().ok()?, fields.next()?.parse().ok()?))
    };
    of("postgres").or_else(|| of("nobody")).map(Some).ok_or_else(|| "no account to run it as".into())
}

fn as_user(command: &mut Command, user: Option<(u32, u32)>) -> &mut Command {
    match user {
        Some((uid, gid)) => command.uid(uid).gid(gid),
        None => command,
    }
}

fn address(socket: &Path, database: &str) -> String {
    format!("host={} user=lumenfab dbname={database}", socket.display())
}

/// A folder of the tests and an empty database for it.
pub(super) struct Database {
    folder: tempfile::TempDir,
}

impl Database {
    /// Says why there is none.
    pub(super) fn new() -> Option<Self> {
        match &*SERVER {
            Ok(server) => {
                let folder = tempfile::tempdir().unwrap();
                fs::write(folder.path().join(SOCKET_FILE), server.socket.to_str().unwrap()).unwrap();
                Some(Self { folder })
            }
            Err(why) => {
                eprintln!("skipped: {why}");
                None
            }
        }
    }

    pub(super) fn folder(&self) -> &Path {
        self.folder.path()
    }

    fn client(&self) -> Client {
        Client::connect(&address_for(self.folder()), NoTls).unwrap()
    }

    /// Another program's hand on it.
    pub(super) fn by_hand(&self, sql: &str) {
        self.client().batch_execute(sql).unwrap();
    }

    /// What the server answers to what it does not do.
    pub(super) fn refused(&self, sql: &str) -> String {
        self.client().batch_execute(sql).unwrap_err().as_db_error().unwrap().message().to_owned()
    }

    /// Ends all other sessions on this database.
    pub(super) fn end_sessions(&self) {
        self.by_hand(
            "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()",
        );
    }
}

/// The database that belongs to a folder, or one within; made where it is not there yet.
pub(super) fn address_for(dir: &Path) -> String {
    apart(|| made_for(dir))
}

/// The client waits, which no task may.
fn apart<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    std::thread::scope(|scope| scope.spawn(work).join().unwrap())
}

fn made_for(dir: &Path) -> String {
    let socket = dir.ancestors().find_map(|dir| fs::read_to_string(dir.join(SOCKET_FILE)).ok());
    let socket = PathBuf::from(socket.expect("no server was made for this folder"));
    let name = format!("q{}", &blake3::hash(dir.to_str().unwrap().as_bytes()).to_hex()[..16]);
    if Client::connect(&address(&socket, &name), NoTls).is_err() {
        let mut client = Client::connect(&address(&socket, "postgres"), NoTls).unwrap();
        // Another process may just have made it.
        client.batch_execute(&format!("CREATE DATABASE {name}")).ok();
    }
    address(&socket, &name)
}
