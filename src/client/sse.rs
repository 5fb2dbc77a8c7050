//! Bytes to server-sent events (WHATWG HTML, 9.2.6). Pure.

/// Longest event, bytes.
const MAX_EVENT: usize = 1 << 20;

/// An event.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Event {
    pub(super) kind: String,
    pub(super) data: String,
    pub(super) id: Option<String>,
    pub(super) retry_ms: Option<u64>,
}

/// An event is longer than any that the server sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("found an event of more than {MAX_EVENT} bytes")]
pub(super) struct TooLong;

/// What has come and is no whole event yet.
#[derive(Debug, Default)]
pub(super) struct Parser {
    line: Vec<u8>,
    event: Event,
    has_data: bool,
}

impl Parser {
    /// The events that are whole with these bytes.
    pub(super) fn feed(&mut self, bytes: &[u8]) -> Result<Vec<Event>, TooLong> {
        let mut events = Vec::new();
        for &byte in bytes {
            match byte {
                b'\n' => events.extend(self.end_line()),
                b'\r' => {}
                other => self.line.push(other),
            }
            if self.line.len() + self.event.data.len() > MAX_EVENT {
                return Err(TooLong);
            }
        }
        Ok(events)
    }

    fn end_line(&mut self) -> Option<Event> {
        let line = std::mem::take(&mut self.line);
        if line.is_empty() {
            let event = std::mem::take(&mut self.event);
            return std::mem::take(&mut self.has_data).then_some(event);
        }
        let line = String::from_utf8_lossy(&line);
        let (field, value) = line.split_once(':').unwrap_or((&line, ""));
        self.take(field, value.strip_prefix(' ').unwrap_or(value));
        None
    }

    fn take(&mut self, field: &str, value: &str) {
        match field {
            "event" => self.event.kind = value.to_owned(),
            "id" => self.event.id = Some(value.to_owned()),
            "retry" => self.event.retry_ms = value.parse().ok(),
            "data" => {
                if self.has_data {
                    self.event.data.push('\n');
                }
                self.event.data.push_str(value);
                self.has_data = true;
            }
            // A comment, or something of a later version.
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENT: &str = ": alive\n\nretry: 3000\nevent: record\nid: 7\ndata: {\"a\":\ndata:  1}\n\nevent: none\n\ndata: x\r\n\r\n";

    fn event(kind: &str, data: &str) -> Event {
        Event { kind: kind.into(), data: data.into(), ..Event::default() }
    }

    #[test]
    fn events_are_the_same_however_they_are_cut() {
        let record = Event { id: Some("7".into()), retry_ms: Some(3000), ..event("record", "{\"a\":\n 1}") };
        let expected = [record, event("", "x")];
        for cut in 0..SENT.len() {
            let mut parser = Parser::default();
            let (before, behind) = SENT.as_bytes().split_at(cut);
            let mut events = parser.feed(before).unwrap();
            events.extend(parser.feed(behind).unwrap());
            assert_eq!(events, expected, "{cut}");
        }
    }

    #[test]
    fn an_endless_event_is_refused() {
        let mut parser = Parser::default();
        assert_eq!(parser.feed(&vec![b'a'; MAX_EVENT + 1]), Err(TooLong));
    }
}
