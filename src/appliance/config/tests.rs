use super::*;

fn faults(text: &str) -> Vec<(usize, String)> {
    let found = Config::parse(text, "config.toml").unwrap_err().faults;
    found.into_iter().map(|fault| (fault.line, fault.text)).collect()
}

#[test]
fn without_a_file_there_is_one_simulated_printer() {
    let config = Config::default();
    let [printer] = &config.printers[..] else { panic!("{config:?}") };
    assert_eq!((printer.name.as_str(), printer.profile.as_str()), ("printer", "marlin"));
    assert_eq!(printer.port, Port::Simulated { speed: "max".into() });
    assert_eq!(
        (config.prepare.workers, config.on_stop, config.webhook, config.watch),
        (1, OnStop::Finish, None, None)
    );
}

#[test]
fn all_faults_are_told_at_once_each_with_line_and_key() {
    let text = "on_stop = \"drop\"\n\n[prepare]\nnice = 40\nworker = 2\n\n[[printer]]\nname = \"a\"\nmax_hotend_c = \"hot\"\n\
                [[printer]]\nname = \"a\"\ncolour = 1\n";
    let expected = [
        (1, "on_stop: found \"drop\", expected one of finish, park, cancel"),
        (4, "prepare.nice: found 40, expected a whole number from 0 to 19"),
        (5, "prepare.worker: there is no such key (did you mean prepare.workers?)"),
        (9, "printer.max_hotend_c: found \"hot\", expected a number from 0 to 500"),
        (11, "printer.name: found a once more, expected another name for each printer"),
        (12, "printer.colour: there is no such key"),
    ];
    assert_eq!(faults(text), expected.map(|(line, text)| (line, text.to_owned())));
    let shown = Config::parse(text, "config.toml").unwrap_err().to_string();
    assert!(shown.starts_with("config.toml:1: on_stop: found"), "{shown}");
}

#[test]
fn a_file_that_is_no_toml_is_told_with_its_line() {
    let told = faults("[http]\ntcp = [");
    assert_eq!((told.len(), told[0].0), (1, 2), "{told:?}");
    assert_eq!(faults("printer = 3\n")[0].1, "printer: there is no such key");
}

#[test]
fn webhooks_go_over_plain_http_and_say_so() {
    let hook = |url: &str| Config::parse(&format!("webhook_url = {url:?}"), "c").map(|config| config.webhook);
    let place = |host: &str, port, path: &str| Some(Webhook { host: host.into(), port, path: path.into() });
    assert_eq!(hook("http://127.0.0.1:9000/x?y=1"), Ok(place("127.0.0.1", 9000, "/x?y=1")));
    assert_eq!(hook("http://lab"), Ok(place("lab", 80, "/")));
    assert_eq!(hook("http://[::1]:81/"), Ok(place("[::1]", 81, "/")));
    assert_eq!(hook("http://[::1]/"), Ok(place("[::1]", 80, "/")));
    for bad in ["https://lab/x", "http://", "http://lab:x/", "http://a b/", "http://user@lab/"] {
        let told = hook(bad).unwrap_err().to_string();
        assert!(told.contains("https is not spoken here"), "{told}");
    }
}

/// Lines of the sample that are keys, all of them commented out, as they would be if they were not.
fn uncommented(sample: &str) -> String {
    let is_key = |line: &&str| !line.is_empty() && *line != "#" && !line.starts_with("# ");
    sample.lines().filter(is_key).map(|line| format!("{}\n", line.trim_start_matches('#'))).collect()
}

#[test]
fn the_sample_says_every_key_with_its_default() {
    let sample = include_str!("../../../deploy/config.toml");
    assert_eq!(Config::parse(sample, "sample"), Ok(Config::default()), "as it is installed");
    let all = uncommented(sample);
    let shown = Config::parse(&all, "sample").unwrap();
    let [printer] = &shown.printers[..] else { panic!("{shown:?}") };
    let default = Config::default();
    let hook = printer.bed_clear.as_ref().map(|hook| hook.longest);
    assert_eq!(hook, Some(Duration::from_secs(600)));
    let optional = PrinterConfig { bed_clear: None, baud: None, material: None, ..printer.clone() };
    assert_eq!([optional], default.printers[..]);
    assert_eq!(
        (shown.prepare, shown.on_stop, shown.http.max_upload_bytes, shown.disk),
        (default.prepare, default.on_stop, default.http.max_upload_bytes, default.disk)
    );
    assert!(shown.webhook.is_some() && printer.baud.is_some() && printer.material.is_some());
    assert!(!shown.ct_folders.is_empty());
    assert_eq!(shown.watch.map(|watch| watch.still), Some(Duration::from_secs(30)));
    assert_eq!(all.matches(" = ").count(), 28, "a key was added: say it in deploy/config.toml");
}
