//! The description of `/api/v1` (OpenAPI 3.1). The OctoPrint part is described by OctoPrint.

use super::access::Viewer;
use super::cases::{pixels, routes};
use super::{jobs, printers, status};
use axum::Json;
use utoipa::OpenApi;
use utoipa::openapi::security::{ApiKey, ApiKeyValue, Http, HttpAuthScheme, SecurityScheme};
use utoipa::{Modify, openapi};

/// All of it.
#[derive(Debug, OpenApi)]
#[openapi(
    info(title = "lumenfab", description = "The print queue of a lumenfab appliance. Over its Unix socket no key is asked for."),
    modifiers(&Keys),
    paths(
        jobs::list, jobs::add, jobs::upload, jobs::show, jobs::change, jobs::history_of, jobs::history,
        printers::list, printers::show, printers::history, printers::load, printers::clear_bed, printers::doubt_bed,
        printers::order, printers::plan,
        status::status, status::health, status::whoami, status::events, status::keys, status::add_key, status::remove_key,
        routes::folders, routes::find_folder, routes::folder, routes::inspect, routes::read_volume, routes::volume, pixels::plane,
        routes::tasks, routes::task, routes::cancel_task, routes::list, routes::begin, routes::show, routes::remove, routes::stages, routes::file,
        routes::queue,
        document,
    )
)]
pub(super) struct Document;

/// Either of the two headers.
struct Keys;

impl Modify for Keys {
    fn modify(&self, document: &mut openapi::OpenApi) {
        let header = SecurityScheme::ApiKey(ApiKey::Header(ApiKeyValue::new("X-Api-Key")));
        let bearer = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        let components = document.components.get_or_insert_default();
        components.add_security_scheme("key", header);
        components.add_security_scheme("bearer", bearer);
        let names = ["key", "bearer"];
        let either = names.map(|name| openapi::SecurityRequirement::new(name, [""; 0])).to_vec();
        document.security = Some(either);
    }
}

/// This description.
#[utoipa::path(get, path = "/api/v1/openapi.json", tag = "server", responses((status = 200, body = Object)))]
pub(super) async fn document(_viewer: Viewer) -> Json<openapi::OpenApi> {
    Json(Document::openapi())
}
