//! The other side of [`crate::http`]: typed calls to a server of lumenfab, over its Unix socket or a loopback address with a key.
//!
//! One connection a call; a call that is given up half-way may still have been done. Adding a job twice under one id adds it
//! once: whoever is unsure asks again. [`Events`] goes on by itself after an interruption, and misses nothing.
//!
//! ```no_run
//! # async fn example() -> Result<(), lumenfab::client::Error> {
//! let client = lumenfab::client::Client::over_socket("/run/lumenfab/socket");
//! client.check_version().await?;
//! for job in client.jobs(lumenfab::store::Which::Live, None, 100).await?.jobs {
//!     assert!(!job.state.is_over());
//! }
//! # Ok(())
//! # }
//! ```

mod cases;
mod error;
mod events;
mod sse;
#[cfg(test)]
mod tests;
mod upload;
mod wire;

pub use error::Error;
pub use events::{Events, Told};

use crate::http::wire::{
    API, Added, Anew, BedClear, Health, HistoryPage, JobList, JobView, KeyBody, KeyList, LoadedBody, NewKey,
    Ordered, PrinterList, PrinterView, Said, Schedule, Status, Whoami, WishesBody,
};
use crate::queue::{JobId, Name, Reason};
use crate::store::Which;
use hyper::Method;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Write as _;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use wire::{Place, Way};

/// A job to be made of a file that is sent along.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct NewJob {
    /// Its name, where the caller makes it.
    pub id: Option<JobId>,
    /// What is decided about it.
    pub wishes: WishesBody,
    /// Whether it goes into the queue at once.
    pub submit: bool,
    /// Why.
    pub why: Reason,
}

/// A server. Clones are the same.
#[derive(Debug, Clone)]
pub struct Client {
    way: Way,
}

/// A name as a part of a path.
fn quoted(name: &Name) -> String {
    let mut quoted = String::new();
    for byte in name.as_str().bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte) {
            quoted.push(char::from(byte));
        } else {
            write!(quoted, "%{byte:02X}").expect("writing to a string cannot fail");
        }
    }
    quoted
}

fn page(path: &str, after: u64, most: u32) -> String {
    format!("{path}?after={after}&most={most}")
}

/// Every call fails with [`Error`]: no server, no answer, or the server's refusal.
impl Client {
    /// At a Unix socket.
    #[must_use]
    pub fn over_socket(path: impl Into<PathBuf>) -> Self {
        Self { way: Way { place: Place::Socket(path.into()), key: None } }
    }

    /// At an address, with a key.
    #[must_use]
    pub fn over_tcp(address: SocketAddr, key: impl Into<String>) -> Self {
        Self { way: Way { place: Place::Tcp(address), key: Some(key.into()) } }
    }

    async fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, Error> {
        self.way.call(Method::GET, path, None).await
    }

    async fn bytes(&self, path: &str) -> Result<hyper::body::Bytes, Error> {
        self.way.bytes(Method::GET, path, None).await
    }

    async fn send<T: DeserializeOwned>(
        &self,
        method: Method,
        path: &str,
        body: &(impl Serialize + Sync),
    ) -> Result<T, Error> {
        let body = serde_json::to_vec(body).map_err(|e| self.way.unreachable(&e))?;
        self.way.call(method, path, Some(body)).await
    }

    /// Whether both sides speak the same version.
    ///
    /// # Errors
    /// [`Error::OtherVersion`] where they do not.
    pub async fn check_version(&self) -> Result<Status, Error> {
        /// What every version has.
        #[derive(serde::Deserialize)]
        struct Spoken {
            api: u32,
        }
        let status: serde_json::Value = self.get("/api/v1/status").await?;
        let wrong = |e: serde_json::Error| Error::NotLumenfab {
            place: self.way.place.to_string(),
            problem: e.to_string(),
        };
        let Spoken { api } = serde_json::from_value(status.clone()).map_err(wrong)?;
        if api == API {
            serde_json::from_value(status).map_err(wrong)
        } else {
            Err(Error::OtherVersion { found: api })
        }
    }

    /// The server at a glance.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn status(&self) -> Result<Status, Error> {
        self.get("/api/v1/status").await
    }

    /// Whether it can do its work.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn health(&self) -> Result<Health, Error> {
        self.get("/api/v1/health").await
    }

    /// Who the server takes this client for.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn whoami(&self) -> Result<Whoami, Error> {
        self.get("/api/v1/whoami").await
    }

    /// Jobs behind one of the same listing, or from its beginning.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn jobs(&self, which: Which, behind: Option<JobId>, most: u32) -> Result<JobList, Error> {
        let which = match which {
            Which::Live => "live",
            Which::Over => "over",
        };
        let behind = behind.map(|id| format!("&behind={id}")).unwrap_or_default();
        self.get(&format!("/api/v1/jobs?which={which}&most={most}{behind}")).await
    }

    /// A job.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn job(&self, id: JobId) -> Result<JobView, Error> {
        self.get(&format!("/api/v1/jobs/{id}")).await
    }

    /// Adds a job of something on the server's own disk.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn add(&self, added: &Added) -> Result<JobView, Error> {
        self.send(Method::POST, "/api/v1/jobs", added).await
    }

    /// Adds a job of a file that is sent along; takes as long as that takes.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn upload(&self, path: &Path, job: &NewJob) -> Result<JobView, Error> {
        let request = upload::request(&self.way, path, job).await?;
        let response = self.way.send(request, None).await?;
        let body = self.way.body(response).await?;
        serde_json::from_slice(&body).map_err(|e| self.way.unreachable(&e))
    }

    /// Changes a job.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn change(&self, id: JobId, anew: &Anew) -> Result<JobView, Error> {
        self.send(Method::POST, &format!("/api/v1/jobs/{id}/changes"), anew).await
    }

    /// Records of a job behind number `after`.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn history_of(&self, id: JobId, after: u64, most: u32) -> Result<HistoryPage, Error> {
        self.get(&page(&format!("/api/v1/jobs/{id}/history"), after, most)).await
    }

    /// Records behind number `after`.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn history(&self, after: u64, most: u32) -> Result<HistoryPage, Error> {
        self.get(&page("/api/v1/history", after, most)).await
    }

    /// All printers.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn printers(&self) -> Result<PrinterList, Error> {
        self.get("/api/v1/printers").await
    }

    /// A printer.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn printer(&self, name: &Name) -> Result<PrinterView, Error> {
        self.get(&format!("/api/v1/printers/{}", quoted(name))).await
    }

    /// Records of a printer behind number `after`.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn printer_history(&self, name: &Name, after: u64, most: u32) -> Result<HistoryPage, Error> {
        self.get(&page(&format!("/api/v1/printers/{}/history", quoted(name)), after, most)).await
    }

    /// Says what a printer is fitted with.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn load(&self, name: &Name, loaded: &LoadedBody) -> Result<PrinterView, Error> {
        self.send(Method::PUT, &format!("/api/v1/printers/{}/loaded", quoted(name)), loaded).await
    }

    /// Gives an operator's word that a bed is clear.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn clear_bed(&self, name: &Name, word: &BedClear) -> Result<PrinterView, Error> {
        self.send(Method::POST, &format!("/api/v1/printers/{}/bed-clear", quoted(name)), word).await
    }

    /// Says that a bed may not be clear.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn doubt_bed(&self, name: &Name, said: &Said) -> Result<PrinterView, Error> {
        self.send(Method::POST, &format!("/api/v1/printers/{}/bed-in-doubt", quoted(name)), said).await
    }

    /// Asks a printer itself for something.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn order(&self, name: &Name, ordered: &Ordered) -> Result<PrinterView, Error> {
        self.send(Method::POST, &format!("/api/v1/printers/{}/orders", quoted(name)), ordered).await
    }

    /// What is next, why nothing is, when each job ends.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn schedule(&self) -> Result<Schedule, Error> {
        self.get("/api/v1/schedule").await
    }

    /// All keys.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn keys(&self) -> Result<KeyList, Error> {
        self.get("/api/v1/keys").await
    }

    /// Makes a key.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn add_key(&self, key: &KeyBody) -> Result<NewKey, Error> {
        self.send(Method::POST, "/api/v1/keys", key).await
    }

    /// Makes a key void.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn remove_key(&self, name: &Name) -> Result<(), Error> {
        self.way.call(Method::DELETE, &format!("/api/v1/keys/{}", quoted(name)), None).await
    }

    /// What happens behind record `after`, or from now on.
    #[must_use]
    pub fn events(&self, after: Option<u64>) -> Events {
        Events::new(self.way.clone(), after)
    }
}
