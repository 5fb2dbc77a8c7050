//! A file as a form, read as it is sent (IO). Of its name only the ending goes over the wire.

use super::wire::{Sent, Way};
use super::{Error, NewJob};
use futures_util::stream::{self, Stream, StreamExt};
use http_body_util::{BodyExt, StreamBody};
use hyper::body::{Bytes, Frame};
use hyper::{Method, Request, header};
use std::io;
use std::path::Path;
use tokio::fs::File;
use tokio::io::AsyncReadExt;

/// Bytes that are read at once.
const CHUNK: usize = 1 << 17;

/// The request that adds a job of a file.
pub(super) async fn request(
    way: &Way,
    path: &Path,
    job: &NewJob,
) -> Result<hyper::http::Result<Request<Sent>>, Error> {
    let failed = |source| Error::File { path: path.to_owned(), source };
    let file = File::open(path).await.map_err(failed)?;
    let length = file.metadata().await.map_err(failed)?.len();
    let mut chance = [0; 16];
    getrandom::fill(&mut chance).map_err(|e| way.unreachable(&e))?;
    let boundary = format!("lumenfab{:032x}", u128::from_ne_bytes(chance));
    let before = before(&boundary, path, job).map_err(|e| failed(e.into()))?;
    let behind = format!("\r\n--{boundary}--\r\n");
    let n_bytes = before.len() as u64 + length + behind.len() as u64;
    let body =
        stream::iter([Ok(Bytes::from(before))]).chain(chunks(file)).chain(stream::iter([Ok(behind.into())]));
    let body = BodyExt::boxed(StreamBody::new(body.map(|bytes: io::Result<Bytes>| bytes.map(Frame::data))));
    Ok(way
        .request(Method::POST, "/api/v1/jobs/upload")
        .header(header::CONTENT_TYPE, format!("multipart/form-data; boundary={boundary}"))
        .header(header::CONTENT_LENGTH, n_bytes)
        .body(body))
}

fn chunks(file: File) -> impl Stream<Item = io::Result<Bytes>> {
    stream::try_unfold(file, |mut file| async {
        let mut chunk = vec![0; CHUNK];
        let n_bytes = file.read(&mut chunk).await?;
        chunk.truncate(n_bytes);
        Ok((n_bytes > 0).then(|| (Bytes::from(chunk), file)))
    })
}

fn before(boundary: &str, path: &Path, job: &NewJob) -> Result<String, serde_json::Error> {
    let field = |name: &str, value: &str| {
        format!("--{boundary}\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n{value}\r\n")
    };
    let mut form = field("submit", if job.submit { "true" } else { "false" });
    form += &field("wishes", &serde_json::to_string(&job.wishes)?);
    form += &field("why", job.why.as_str());
    if let Some(id) = job.id {
        form += &field("id", &id.to_string());
    }
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    let ending: String = ending.chars().filter(char::is_ascii_alphanumeric).collect();
    let disposition = format!("form-data; name=\"file\"; filename=\"job.{ending}\"");
    form += &format!(
        "--{boundary}\r\nContent-Disposition: {disposition}\r\nContent-Type: application/octet-stream\r\n\r\n"
    );
    Ok(form)
}
