//! What a request brings, with errors in the one shape.

use super::error::Problem;
use crate::queue::{JobId, Name};
use axum::Json;
use axum::extract::rejection::JsonRejection;
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::StatusCode;
use axum::http::request::Parts;
use serde::de::DeserializeOwned;
use std::time::Duration;
use tokio::time::timeout;

/// How long a body that is no upload may take.
const PATIENCE: Duration = Duration::from_secs(15);

/// A body in JSON.
#[derive(Debug)]
pub(super) struct Body<T>(pub(super) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &S) -> Result<Self, Problem> {
        match timeout(PATIENCE, Json::from_request(request, app)).await {
            Ok(Ok(Json(body))) => Ok(Self(body)),
            Ok(Err(rejection)) => Err(unreadable(&rejection)),
            Err(_late) => {
                let message = "the body of the request did not come in time";
                Err(Problem::new(StatusCode::REQUEST_TIMEOUT, "http.too_slow", message))
            }
        }
    }
}

fn unreadable(rejection: &JsonRejection) -> Problem {
    let status = rejection.status();
    let code = match status {
        StatusCode::UNSUPPORTED_MEDIA_TYPE => "http.no_json",
        StatusCode::PAYLOAD_TOO_LARGE => "http.too_large",
        _ => "http.malformed",
    };
    Problem::new(status, code, rejection.body_text())
}

/// What stands behind the question mark.
#[derive(Debug)]
pub(super) struct Asked<T>(pub(super) T);

impl<T: DeserializeOwned, S: Sync> FromRequestParts<S> for Asked<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _app: &S) -> Result<Self, Problem> {
        let wrong = |message: String| Problem::bad("http.malformed", message);
        Query::try_from_uri(&parts.uri).map(|Query(asked)| Self(asked)).map_err(|e| wrong(e.body_text()))
    }
}

/// The job that a path names.
#[derive(Debug)]
pub(super) struct OfJob(pub(super) JobId);

impl<S: Send + Sync> FromRequestParts<S> for OfJob {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, app: &S) -> Result<Self, Problem> {
        let no_job = || Problem::new(StatusCode::NOT_FOUND, "queue.no_job", "there is no job of this name");
        let text = Path::<String>::from_request_parts(parts, app).await.map_err(|_unreadable| no_job())?;
        text.parse().map(Self).map_err(|_no_id| no_job())
    }
}

/// The printer or key that a path names.
#[derive(Debug)]
pub(super) struct Named(pub(super) Name);

impl<S: Send + Sync> FromRequestParts<S> for Named {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, app: &S) -> Result<Self, Problem> {
        let nothing =
            || Problem::new(StatusCode::NOT_FOUND, "http.not_found", "there is nothing of this name");
        let text = Path::<String>::from_request_parts(parts, app).await.map_err(|_unreadable| nothing())?;
        Ok(Self(Name::try_new(&text)?))
    }
}
