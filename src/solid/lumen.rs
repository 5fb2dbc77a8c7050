//! The lumen's skin: through the contours of the CT planes, events on fitted lobe fields.

use super::Error;
use super::assemble::{Recipe, assemble};
use super::event::{EventPlanes, EventSource};
use super::lobes::LobeSource;
use super::skin::{Correspondence, Skin};
use crate::progress::Task;
use crate::topology::Graph;

struct Lumen {
    correspondence: Correspondence,
}

impl Recipe for Lumen {
    fn source<'a>(&'a self, planes: &EventPlanes, _sign: f64) -> Option<Box<dyn EventSource + 'a>> {
        LobeSource::fit(planes).map(|s| Box::new(s) as Box<dyn EventSource>)
    }

    fn is_measured(&self) -> bool {
        true
    }

    fn correspondence(&self) -> Correspondence {
        self.correspondence
    }
}

/// Builds the lumen's skin from the graph of its contours.
pub(super) fn build(graph: &Graph, correspondence: Correspondence, task: &Task<'_>) -> Result<Skin, Error> {
    assemble(graph, &Lumen { correspondence }, task)
}
