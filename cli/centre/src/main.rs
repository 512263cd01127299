//! The `volcomp-centre` command: the control centre of many machine tools.

use std::process::ExitCode;

use clap::Parser;
use volcomp_centre::command::Arguments;

fn main() -> ExitCode {
    match Arguments::parse().act() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.status())
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn man_pages_are_those_of_the_help() {
        let command = super::Arguments::command();
        volcomp_test_support::man_pages::compare(command, "8", "", &[]);
    }
}
