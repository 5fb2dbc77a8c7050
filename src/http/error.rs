//! What a caller is told when something is not done: a status, a stable code, plain words; never what the inside looks like.

use super::wire::{ErrorBody, Fault};
use crate::queue::Refusal;
use crate::store;
use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Why a request is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Problem {
    /// Status of the answer.
    pub status: StatusCode,
    /// Stable name for programs.
    pub code: &'static str,
    /// In plain words, with what to do.
    pub message: String,
    /// When it is worth another try, s.
    pub retry_after_s: Option<u64>,
}

impl Problem {
    /// A refusal.
    #[must_use]
    pub fn new(status: StatusCode, code: &'static str, message: impl Into<String>) -> Self {
        Self { status, code, message: message.into(), retry_after_s: None }
    }

    /// The request is not what it should be.
    pub(super) fn bad(code: &'static str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, code, message)
    }

    /// It cannot be now, or not with what there is.
    pub(super) fn conflict(code: &'static str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, code, message)
    }

    /// Too much at once.
    pub(super) fn busy(code: &'static str, message: impl Into<String>, retry_after_s: u64) -> Self {
        let problem = Self::new(StatusCode::SERVICE_UNAVAILABLE, code, message);
        Self { retry_after_s: Some(retry_after_s), ..problem }
    }

    /// Something failed that the caller can do nothing about; what it was is in the log.
    pub(super) fn inside(what: &str, problem: &dyn std::fmt::Display) -> Self {
        tracing::error!("{what}: {problem}");
        let message = format!("{what} failed: look into the log of lumenfab");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "http.failed", message)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let fault = Fault { code: self.code.to_owned(), message: self.message };
        let mut response = (self.status, Json(ErrorBody { error: fault })).into_response();
        let headers = response.headers_mut();
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        if let Some(seconds) = self.retry_after_s {
            headers.insert(header::RETRY_AFTER, seconds.into());
        }
        response
    }
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        Self::new(status(&refusal), refusal.code(), refusal.to_string())
    }
}

/// The status of each refusal of the queue.
const fn status(refusal: &Refusal) -> StatusCode {
    use Refusal as R;
    match refusal {
        R::NoJob { .. } | R::NoPrinter { .. } => StatusCode::NOT_FOUND,
        R::NotForYou { .. } | R::NoEvidence => StatusCode::FORBIDDEN,
        R::Copies { .. } | R::PlaceByHand | R::NoReason { .. } | R::Text { .. } | R::SpecTooLarge { .. } => {
            StatusCode::UNPROCESSABLE_ENTITY
        }
        R::NotInState { .. }
        | R::ChangedMeanwhile { .. }
        | R::ClaimLost
        | R::InHand { .. }
        | R::MaterialLaid
        | R::NothingLaid
        | R::NotPrepared
        | R::IsPrepared
        | R::NoCopyLeft
        | R::CopiesLeft
        | R::SignOff { .. }
        | R::NotDue { .. }
        | R::BedNotClear { .. }
        | R::BedInUse { .. }
        | R::Misfit(_)
        | R::IdTaken { .. } => StatusCode::CONFLICT,
    }
}

impl From<store::Error> for Problem {
    fn from(error: store::Error) -> Self {
        use store::Error as E;
        let code = error.code();
        let unavailable = |words: &str| Self::busy(code, words, 5);
        let damaged = |words: &str| Self::new(StatusCode::INTERNAL_SERVER_ERROR, code, words);
        // Messages of the store name the database's path, which is nobody's business but the log's.
        if !matches!(error, E::Refused(_)) {
            tracing::error!("queue: {error}");
        }
        match error {
            E::Refused(refusal) => refusal.into(),
            E::Full { .. } => unavailable("the disk of the queue is full: make room; nothing is lost"),
            E::ReadOnly { .. } => unavailable("the queue can only be read: check the rights of its folder"),
            E::Locked { .. } => unavailable("another program keeps the queue locked: try again"),
            E::Io { .. } => unavailable("the queue cannot be read or written: look into the log of lumenfab"),
            E::Server { .. } => {
                unavailable("the server of the queue does not answer: look into the log of lumenfab")
            }
            E::Panicked => damaged("a fault of lumenfab: nothing was changed; look into its log"),
            E::Gone => unavailable("the queue has been closed: start lumenfab again"),
            E::History(_) => damaged("the history of the queue was changed: look into the log of lumenfab"),
            E::Damaged { .. } => damaged("the queue is damaged: restore the last backup"),
            E::NotADatabase { .. } | E::Foreign { .. } | E::Newer { .. } | E::NoWal { .. } | E::Address => {
                damaged("the queue cannot be used: look into the log of lumenfab")
            }
        }
    }
}
