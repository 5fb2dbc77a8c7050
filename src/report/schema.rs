//! The published schema of `report.json` (JSON Schema 2020-12).

/// The schema's text.
pub const REPORT: &str = include_str!("report.schema.json");

#[cfg(test)]
pub(super) mod tests {
    use super::super::record::Record;
    use super::super::testing::Case;
    use super::super::{Inputs, Report, build, testing::inputs};
    use crate::progress::Task;
    use serde_json::Value;

    /// What a document breaks, by the keywords that the schema uses; a field that it does not describe counts, too.
    fn faults(schema: &Value, at: &str, value: &Value, root: &Value, faults: &mut Vec<String>) {
        for (keyword, rule) in schema.as_object().unwrap() {
            let holds = match keyword.as_str() {
                "$schema" | "$defs" | "title" | "description" => true,
                "$ref" => {
                    let place = rule.as_str().unwrap().trim_start_matches('#');
                    self::faults(root.pointer(place).unwrap(), at, value, root, faults);
                    true
                }
                "type" => rule
                    .as_array()
                    .map_or_else(|| is(rule, value), |types| types.iter().any(|t| is(t, value))),
                "const" => rule == value,
                "enum" => rule.as_array().unwrap().contains(value),
                "minimum" => value.as_f64().is_none_or(|v| v >= rule.as_f64().unwrap()),
                "maximum" => value.as_f64().is_none_or(|v| v <= rule.as_f64().unwrap()),
                "minItems" => value.as_array().is_none_or(|v| v.len() as u64 >= rule.as_u64().unwrap()),
                "maxItems" => value.as_array().is_none_or(|v| v.len() as u64 <= rule.as_u64().unwrap()),
                "required" => value.as_object().is_none_or(|v| {
                    rule.as_array().unwrap().iter().all(|name| v.contains_key(name.as_str().unwrap()))
                }),
                "items" => {
                    for (i, item) in value.as_array().into_iter().flatten().enumerate() {
                        self::faults(rule, &format!("{at}/{i}"), item, root, faults);
                    }
                    true
                }
                "properties" => {
                    for (name, own) in value.as_object().into_iter().flatten() {
                        match rule.get(name) {
                            Some(rule) => self::faults(rule, &format!("{at}/{name}"), own, root, faults),
                            None => faults.push(format!("{at}/{name} is not described")),
                        }
                    }
                    true
                }
                other => panic!("the test does not know the keyword {other}"),
            };
            if !holds {
                faults.push(format!("{at} breaks {keyword}: {value}"));
            }
        }
    }

    fn is(name: &Value, value: &Value) -> bool {
        match name.as_str().unwrap() {
            "object" => value.is_object(),
            "array" => value.is_array(),
            "string" => value.is_string(),
            "boolean" => value.is_boolean(),
            "null" => value.is_null(),
            "number" => value.is_number(),
            "integer" => value.is_u64() || value.is_i64(),
            other => panic!("no such type: {other}"),
        }
    }

    pub(in crate::report) fn broken(report: &Report) -> Vec<String> {
        let schema: Value = serde_json::from_str(super::REPORT).unwrap();
        let document = serde_json::from_str(&report.to_json().unwrap()).unwrap();
        let mut found = Vec::new();
        faults(&schema, "", &document, &schema, &mut found);
        found
    }

    #[test]
    fn reports_obey_the_schema_and_it_describes_every_field() {
        let case = Case::new(3);
        let made = |inputs: &Inputs<'_>| broken(&build(inputs, &Task::quiet()).unwrap());
        assert_eq!(made(&inputs(&case)), [""; 0]);
        assert_eq!(made(&Inputs { image: None, ..inputs(&case) }), [""; 0]);
        let nothing = Record::default();
        assert_eq!(made(&Inputs { record: &nothing, ..inputs(&case) }), [""; 0]);
    }

    #[test]
    fn a_report_that_breaks_it_is_found() {
        let mut report = build(&inputs(&Case::new(2)), &Task::quiet()).unwrap();
        report.layers[1].iou = Some(1.5);
        assert_eq!(broken(&report), ["/layers/1/iou breaks maximum: 1.5"]);
    }
}
