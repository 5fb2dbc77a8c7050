-- Bodies are JSON and what counts; the other columns of a job follow from its body and are there to find it.

-- What jobs ask of a printer, each once: few, however many jobs there are.
CREATE TABLE needs (
    id INTEGER PRIMARY KEY,
    body TEXT NOT NULL UNIQUE
) STRICT;

CREATE TABLE jobs (
    id TEXT PRIMARY KEY NOT NULL,
    body TEXT NOT NULL,
    urgency INTEGER NOT NULL,           -- minus the priority: less is earlier
    rank TEXT NOT NULL UNIQUE,
    needs INTEGER NOT NULL REFERENCES needs (id),
    filament_mm3 INTEGER NOT NULL,      -- of one copy
    waits TEXT CHECK (waits IN ('prepare', 'print')),
    due_ms INTEGER,                     -- not known to be due before this time has come
    over_seq INTEGER                    -- the record with which it was over
) STRICT, WITHOUT ROWID;

CREATE INDEX jobs_to_print ON jobs (needs, urgency, rank, filament_mm3) WHERE waits = 'print' AND due_ms IS NULL;
CREATE INDEX jobs_to_prepare ON jobs (urgency, rank) WHERE waits = 'prepare';
CREATE INDEX jobs_due ON jobs (due_ms) WHERE due_ms IS NOT NULL;
CREATE INDEX jobs_live ON jobs (urgency, rank) WHERE over_seq IS NULL;
CREATE INDEX jobs_over ON jobs (over_seq) WHERE over_seq IS NOT NULL;

CREATE TABLE specs (
    job TEXT PRIMARY KEY NOT NULL REFERENCES jobs (id),
    kind TEXT NOT NULL,
    bytes BLOB NOT NULL
) STRICT;

CREATE TABLE claims (
    job TEXT PRIMARY KEY NOT NULL REFERENCES jobs (id),
    holder TEXT NOT NULL,
    token INTEGER NOT NULL,
    until_ms INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE INDEX claims_until ON claims (until_ms);
CREATE INDEX claims_holder ON claims (holder);

CREATE TABLE printers (
    name TEXT PRIMARY KEY NOT NULL,
    body TEXT NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE history (
    seq INTEGER PRIMARY KEY,
    subject TEXT NOT NULL,
    body TEXT NOT NULL,
    digest TEXT NOT NULL
) STRICT;

CREATE INDEX history_of ON history (subject, seq);

CREATE TRIGGER history_is_not_changed BEFORE UPDATE ON history
BEGIN SELECT RAISE(ABORT, 'the history is only added to'); END;
CREATE TRIGGER history_is_not_cut BEFORE DELETE ON history
BEGIN SELECT RAISE(ABORT, 'the history is only added to'); END;
-- Replacing a row goes past the trigger on deletes.
CREATE TRIGGER history_is_not_replaced BEFORE INSERT ON history WHEN NEW.seq <= (SELECT max(seq) FROM history)
BEGIN SELECT RAISE(ABORT, 'the history is only added to'); END;

CREATE TABLE head (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    seq INTEGER NOT NULL,
    digest TEXT NOT NULL
) STRICT;
