//! The program that clears a bed and says that it is clear (IO).

use super::config::Hook;
use crate::queue::JobId;
use std::process::Stdio;
use tokio::process::Command;

/// Runs it; it has to end with 0 in time. It is ended when this is dropped.
///
/// # Errors
/// Why the bed is not known to be clear, in words without paths.
pub(super) async fn run(hook: &Hook, printer: &str, job: JobId) -> Result<(), String> {
    let [program, args @ ..] = &hook.program[..] else { return Err("no program is named".to_owned()) };
    let mut command = Command::new(program);
    command
        .args(args)
        .env("LUMENFAB_PRINTER", printer)
        .env("LUMENFAB_JOB", job.to_string())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .kill_on_drop(true);
    let mut child = command.spawn().map_err(|error| format!("it cannot be started: {}", error.kind()))?;
    match tokio::time::timeout(hook.longest, child.wait()).await {
        Ok(Ok(status)) if status.success() => Ok(()),
        Ok(Ok(status)) => Err(format!("it ended with {status}")),
        Ok(Err(error)) => Err(format!("it cannot be waited for: {}", error.kind())),
        Err(_late) => Err(format!("it did not end within {} s", hook.longest.as_secs())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    async fn cleared(script: &str, longest_ms: u64) -> Result<(), String> {
        let program = ["/bin/sh", "-c", script].map(str::to_owned).to_vec();
        let hook = Hook { program, longest: Duration::from_millis(longest_ms) };
        run(&hook, "left", JobId::at(jiff::Timestamp::UNIX_EPOCH, [7; 10])).await
    }

    #[tokio::test]
    async fn a_bed_is_clear_where_the_program_says_so_in_time_and_nowhere_else() {
        assert_eq!(
            cleared("test \"$LUMENFAB_PRINTER\" = left -a -n \"$LUMENFAB_JOB\"", 20_000).await,
            Ok(())
        );
        assert_eq!(cleared("exit 3", 20_000).await, Err("it ended with exit status: 3".to_owned()));
        assert_eq!(cleared("kill -9 $$", 20_000).await, Err("it ended with signal: 9 (SIGKILL)".to_owned()));
        assert_eq!(cleared("sleep 60", 50).await, Err("it did not end within 0 s".to_owned()));
        let hook = Hook { program: vec!["/nonexistent/hook".into()], longest: Duration::from_secs(1) };
        let missing = run(&hook, "left", JobId::at(jiff::Timestamp::UNIX_EPOCH, [7; 10])).await;
        assert_eq!(missing, Err("it cannot be started: entity not found".to_owned()));
    }
}
