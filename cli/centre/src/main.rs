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
    fn every_option_has_help_for_its_man_page() {
        volcomp_test_support::man_pages::write(super::Arguments::command(), "8", "");
    }
}
