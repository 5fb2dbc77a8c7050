//! Tables, indices and triggers as they are, and as they would be if they were made now.

use super::open::{SCHEMA, STEPS};
use postgres::{Config, NoTls, Transaction};

/// A name and its definition.
pub(super) type Definition = (String, String);

/// What there is of a schema, without the schema's own name.
const DEFINITIONS: &str = "
    SELECT 'column ' || table_name || '.' || column_name,
           data_type || ' ' || is_nullable || ' ' || coalesce(collation_name, '') || ' ' || is_identity || coalesce(column_default, '')
    FROM information_schema.columns WHERE table_schema = $1
    UNION ALL
    SELECT 'constraint ' || conname::text, pg_get_constraintdef(c.oid)
    FROM pg_constraint c WHERE connamespace = to_regnamespace($1)
    UNION ALL
    SELECT 'index ' || indexname::text, indexdef FROM pg_indexes WHERE schemaname = $1
    UNION ALL
    SELECT 'trigger ' || tgname::text, tgenabled::text || ' ' || pg_get_triggerdef(t.oid)
    FROM pg_trigger t JOIN pg_class r ON r.oid = tgrelid WHERE relnamespace = to_regnamespace($1) AND NOT tgisinternal
    UNION ALL
    SELECT 'function ' || proname::text, prosrc FROM pg_proc WHERE pronamespace = to_regnamespace($1)";

/// Both, over a connection of its own; what is made for the comparison is taken back.
pub(super) fn found_and_expected(
    config: &Config,
) -> Result<(Vec<Definition>, Vec<Definition>), postgres::Error> {
    let mut client = config.connect(NoTls)?;
    let mut tx = client.transaction()?;
    let found = definitions(&mut tx, SCHEMA)?;
    let fresh = format!("{SCHEMA}_as_made");
    tx.batch_execute(&format!("CREATE SCHEMA {fresh}; SET LOCAL search_path = {fresh}"))?;
    for step in STEPS {
        tx.batch_execute(step)?;
    }
    let expected = definitions(&mut tx, &fresh)?;
    tx.rollback()?;
    Ok((found, expected))
}

fn definitions(tx: &mut Transaction<'_>, schema: &str) -> Result<Vec<Definition>, postgres::Error> {
    let rows = tx.query(DEFINITIONS, &[&schema])?;
    let own = format!("{schema}.");
    rows.iter().map(|row| Ok((row.try_get(0)?, row.try_get::<_, String>(1)?.replace(&own, "")))).collect()
}
