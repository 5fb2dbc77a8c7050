//! Who asks, and whether they may: every request has a [`Caller`] before a handler sees it.
//!
//! A handler takes one of `Viewer`, `Operator`, `Admin` as an argument; there is no other way to learn who asks.

use super::appliance::Appliance;
use super::error::Problem;
use super::wire::Access;
use crate::queue::{Name, Refusal};
use crate::store::Store;
use axum::extract::{FromRequestParts, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;

/// The other end of a connection; the server's edge puts it into every request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Peer {
    /// A process on this machine that may open the socket: its user's name.
    Socket(Name),
    /// An address.
    Tcp(IpAddr),
}

/// Who asks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    /// As it goes into the history.
    pub name: Name,
    /// What they may do.
    pub access: Access,
    /// Whether they are on this machine, behind the rights of the socket.
    pub is_local: bool,
}

impl Caller {
    /// The name under which a person's decision is recorded, with the key that was used beside it.
    pub(super) fn named(&self, person: Option<&Name>) -> Result<Name, Refusal> {
        match person {
            Some(person) if *person != self.name => Name::try_new(&format!("{person} (by {})", self.name)),
            _ => Ok(self.name.clone()),
        }
    }

    /// Whether they may do so.
    pub(super) fn check(&self, needed: Access) -> Result<(), Problem> {
        if self.access >= needed {
            return Ok(());
        }
        let (found, needed) = (self.access.words(), needed.words());
        let message = format!("the key allows \"{found}\", this needs \"{needed}\": use another key");
        Err(Problem::new(StatusCode::FORBIDDEN, "http.not_allowed", message))
    }
}

macro_rules! caller_who_may {
    ($name:ident, $access:expr, $doc:literal) => {
        #[doc = $doc]
        #[derive(Debug, Clone)]
        pub(super) struct $name(pub(super) Caller);

        impl<S: Sync> FromRequestParts<S> for $name {
            type Rejection = Problem;

            async fn from_request_parts(parts: &mut Parts, _app: &S) -> Result<Self, Problem> {
                let caller = parts.extensions.get::<Caller>().ok_or_else(no_key)?;
                caller.check($access)?;
                Ok(Self(caller.clone()))
            }
        }
    };
}

caller_who_may!(Viewer, Access::View, "May look.");
caller_who_may!(Operator, Access::Operate, "May run queue and printers.");
caller_who_may!(Admin, Access::Admin, "May give keys and send commands.");

fn no_key() -> Problem {
    let message = "a key is needed: send it in the header X-Api-Key";
    Problem::new(StatusCode::UNAUTHORIZED, "http.no_key", message)
}

/// Finds out who asks; nothing goes on without.
pub(super) async fn identify<S: Store>(
    State(app): State<Appliance<S>>,
    mut request: Request,
    next: Next,
) -> Response {
    let peer = request.extensions().get::<Peer>().cloned();
    match caller(&app, peer, request.headers()).await {
        Ok(caller) => {
            request.extensions_mut().insert(caller);
            next.run(request).await
        }
        Err(problem) => as_expected(problem, request.uri().path()).into_response(),
    }
}

async fn caller<S: Store>(
    app: &Appliance<S>,
    peer: Option<Peer>,
    headers: &HeaderMap,
) -> Result<Caller, Problem> {
    match peer {
        Some(Peer::Socket(name)) => Ok(Caller { name, access: Access::Admin, is_local: true }),
        Some(Peer::Tcp(address)) => {
            let key = key(headers).ok_or_else(no_key)?;
            let (name, access) = app.keys.check(key, address).await?;
            Ok(Caller { name, access, is_local: false })
        }
        None => Err(no_key()),
    }
}

/// From `X-Api-Key`, or from `Authorization: Bearer`.
fn key(headers: &HeaderMap) -> Option<&str> {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    let bearer = || {
        let (scheme, key) = text(header::AUTHORIZATION.as_str())?.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then(|| key.trim())
    };
    text("x-api-key").or_else(bearer).filter(|key| !key.is_empty())
}

/// Clients of OctoPrint know 403 where there is no good key, and nothing else.
fn as_expected(problem: Problem, path: &str) -> Problem {
    if problem.status == StatusCode::UNAUTHORIZED && !path.starts_with("/api/v1/") {
        Problem { status: StatusCode::FORBIDDEN, ..problem }
    } else {
        problem
    }
}
