-- Bodies are JSON and what counts; the other columns of a job follow from its body and are there to find it.
-- Names and places are compared byte by byte, as SQLite does.

-- The version of the format; whoever writes keeps this row to itself until it is done.
CREATE TABLE format (
    id BIGINT PRIMARY KEY CHECK (id = 1),
    version BIGINT NOT NULL
);

-- What jobs ask of a printer, each once: few, however many jobs there are.
CREATE TABLE needs (
    id BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    body TEXT COLLATE "C" NOT NULL UNIQUE
);

CREATE TABLE jobs (
    id TEXT COLLATE "C" PRIMARY KEY,
    body TEXT NOT NULL,
    urgency BIGINT NOT NULL,            -- minus the priority: less is earlier
    rank TEXT COLLATE "C" NOT NULL UNIQUE,
    needs BIGINT NOT NULL REFERENCES needs (id),
    filament_mm3 BIGINT NOT NULL,       -- of one copy
    waits TEXT COLLATE "C" CHECK (waits IN ('prepare', 'print')),
    due_ms BIGINT,                      -- not known to be due before this time has come
    over_seq BIGINT                     -- the record with which it was over
);

CREATE INDEX jobs_to_print ON jobs (needs, urgency, rank, filament_mm3) WHERE waits = 'print' AND due_ms IS NULL;
CREATE INDEX jobs_to_prepare ON jobs (urgency, rank) WHERE waits = 'prepare';
CREATE INDEX jobs_due ON jobs (due_ms) WHERE due_ms IS NOT NULL;
CREATE INDEX jobs_live ON jobs (urgency, rank) WHERE over_seq IS NULL;
CREATE INDEX jobs_over ON jobs (over_seq) WHERE over_seq IS NOT NULL;

CREATE TABLE specs (
    job TEXT COLLATE "C" PRIMARY KEY REFERENCES jobs (id),
    kind TEXT NOT NULL,
    bytes BYTEA NOT NULL
);

CREATE TABLE claims (
    job TEXT COLLATE "C" PRIMARY KEY REFERENCES jobs (id),
    holder TEXT COLLATE "C" NOT NULL,
    token BIGINT NOT NULL,
    until_ms BIGINT NOT NULL
);

CREATE INDEX claims_until ON claims (until_ms);
CREATE INDEX claims_holder ON claims (holder);

CREATE TABLE printers (
    name TEXT COLLATE "C" PRIMARY KEY,
    body TEXT NOT NULL
);

CREATE TABLE history (
    seq BIGINT PRIMARY KEY,
    subject TEXT COLLATE "C" NOT NULL,
    body TEXT NOT NULL,
    digest TEXT NOT NULL
);

CREATE INDEX history_of ON history (subject, seq);

CREATE FUNCTION history_is_kept() RETURNS trigger LANGUAGE plpgsql AS
$$ BEGIN RAISE EXCEPTION 'the history is only added to'; END $$;

CREATE TRIGGER history_is_kept BEFORE UPDATE OR DELETE OR TRUNCATE ON history
FOR EACH STATEMENT EXECUTE FUNCTION history_is_kept();

CREATE TABLE head (
    id BIGINT PRIMARY KEY CHECK (id = 1),
    seq BIGINT NOT NULL,
    digest TEXT NOT NULL
);
