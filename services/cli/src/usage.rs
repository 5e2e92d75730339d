//! A command line of which no command comes: what is printed in its place. That is the help or the version that it asks for, or what is wrong with it.

use std::process::ExitCode;

use clap::error::{ContextKind, ContextValue};
use repose_proto::CallError;

use crate::failure::Failure;
use crate::output::Output;

/// The field of an error that is about no one argument.
const COMMAND: &str = "command";

/// Prints what clap says where clap would, and with `--json` the document of an error. Whether that was given is read off the arguments themselves:
/// nothing else of them is known.
pub fn print(said: &clap::Error) -> ExitCode {
    // Where nobody reads it, the exit code still tells.
    let _unread = said.print();
    if !said.use_stderr() {
        return ExitCode::SUCCESS;
    }
    let error = CallError::invalid(field_of(said), message_of(&said.to_string()));
    Output { json: std::env::args_os().any(|argument| argument == "--json") }.print_error_document(&error);
    ExitCode::from(Failure::BadInput(error).exit_code())
}

/// The option or argument that an error is about, as other errors name it: `goal` for `--goal <TERM>`.
fn field_of(said: &clap::Error) -> String {
    let named = match said.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(name)) => Some(name),
        Some(ContextValue::Strings(names)) => names.first(),
        _ => None,
    };
    let name = named.and_then(|name| bare(name)).unwrap_or(COMMAND);
    name.to_lowercase()
}

/// An argument's name without its dashes or brackets, and without what stands for its value.
fn bare(name: &str) -> Option<&str> {
    let name = name.split([' ', '=']).next()?.trim_matches(|c: char| !c.is_alphanumeric());
    (!name.is_empty()).then_some(name)
}

/// What is wrong, in one line: usage and hints that follow it are for people.
fn message_of(text: &str) -> String {
    let wrong = text.split("\n\n").next().unwrap_or(text);
    wrong.trim_start_matches("error: ").split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_argument_is_named_by_its_name_alone_and_its_fault_told_without_the_usage() {
        assert_eq!(
            [bare("--goal <TERM>"), bare("<ROLES>"), bare("-x"), bare("--out=PNG")],
            [Some("goal"), Some("ROLES"), Some("x"), Some("out")]
        );
        assert_eq!([bare("--"), bare("")], [None; 2]);
        let text = "error: the following required arguments were not provided:\n  --goal <TERM>\n\nUsage: repose place\n\nFor more …\n";
        assert_eq!(message_of(text), "the following required arguments were not provided: --goal <TERM>");
    }
}
