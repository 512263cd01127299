//! `init`: a first configuration, commented, that passes `check`. The keys of a device come from its driver.

use std::{
    fs,
    io::{self, BufRead, IsTerminal, Write},
    path::{Path, PathBuf},
};

use volcomp_devices::{FirstMachine, Setting, controllers, first_controller, first_thermometer};
use volcomp_model::{Fading, Machine};
use volcomp_runtime::Model;
use volcomp_vocabulary::AxisName;

use crate::{
    config::{Config, GuardTable},
    error::GatewayError,
    plan::Plan,
    token::{private_file, secret},
};

/// Options of `init`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct InitArguments {
    /// The TOML file to write; it must not exist
    config: PathBuf,
    /// The machine file
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Device URL of the control, which names its bus
    #[arg(long, value_name = "URL")]
    control: Option<String>,
    /// Corrected axes, in the control's order [default: those of the machine file]
    #[arg(long, value_name = "LETTERS", value_delimiter = ',')]
    axes: Vec<AxisName>,
    /// Device URL of a thermometer, and the names of its sensors: bed,column; may be repeated
    #[arg(long, num_args = 2, value_names = ["URL", "NAMES"])]
    sensors: Vec<String>,
}

/// Writes a first configuration, and returns the files written.
///
/// # Errors
/// The file exists, or the configuration would not pass `check`: then nothing is written.
pub fn init(mut arguments: InitArguments) -> Result<String, GatewayError> {
    let path = arguments.config.clone();
    let shown = path.display();
    if path.symlink_metadata().is_ok() {
        return Err(GatewayError::invalid_in(
            shown,
            "the file exists, expected a new one: init overwrites nothing",
        ));
    }
    if arguments.machine.is_none() || arguments.control.is_none() {
        if !io::stdin().is_terminal() {
            return Err(GatewayError::invalid(
                "init needs --machine FILE and --control URL: standard input is no terminal on which it could ask",
            ));
        }
        arguments.ask(&mut io::stdin().lock(), &mut io::stderr())?;
    }
    let first = arguments.text()?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut written = String::new();
    let mut key_file = None;
    if let Some(name) = first.key_file {
        let file = folder.join(name);
        if file.symlink_metadata().is_err() {
            let failed = |e| GatewayError::system(file.display().to_string(), e);
            let key = secret()? + "\n";
            let mut new = private_file(&file).map_err(failed)?;
            new.write_all(key.as_bytes()).map_err(failed)?;
            written = format!("{}: a new key\n", file.display());
            key_file = Some(file);
        }
    }
    let checked = Config::parse(&first.text, &shown.to_string(), folder)
        .map_err(GatewayError::from)
        .and_then(Plan::new)
        .and_then(|plan| {
            let failed = |e| GatewayError::system(shown.to_string(), e);
            let mut file = fs::File::create_new(&path).map_err(failed)?;
            file.write_all(first.text.as_bytes()).map_err(failed)?;
            Ok(plan.sensor_notes())
        });
    let notes = checked.inspect_err(|_| {
        // The key was made for this configuration only. A failed removal of the key is ignored: the caller needs the
        // first error.
        let _ = key_file.map(fs::remove_file);
    })?;
    let notes = notes.iter().map(|note| format!("note: {note}\n"));
    Ok(format!("{shown}: a new configuration\n{written}{}", notes.collect::<String>()))
}

struct FirstText {
    text: String,
    key_file: Option<&'static str>,
}

impl InitArguments {
    /// Asks for the settings without an option. An empty answer selects the default.
    ///
    /// # Errors
    /// The machine file cannot be read, or the input ends before a question is answered.
    fn ask(
        &mut self,
        input: &mut impl BufRead,
        output: &mut impl Write,
    ) -> Result<(), GatewayError> {
        if self.machine.is_none() {
            let file = ask(input, output, "Machine file", "machine.toml")?;
            self.machine = Some(file.into());
        }
        let model = self.model()?;
        if self.control.is_none() {
            let known = controllers();
            let known = known.iter().map(|(url, name)| format!("  {url}  {name}\n"));
            let question = format!("{}Device URL of the control", known.collect::<String>());
            self.control = Some(ask(input, output, &question, "")?);
        }
        if self.axes.is_empty() {
            let letters: Vec<String> = model.axes.iter().map(ToString::to_string).collect();
            let answer = ask(input, output, "Corrected axes", &letters.join(","))?;
            let axes = answer.split(',').map(|letter| letter.trim().parse());
            self.axes = axes.collect::<Result<_, _>>().map_err(|_| {
                GatewayError::invalid(format!("axes: found {answer:?}, expected letters: X,Y,Z"))
            })?;
        }
        if self.sensors.is_empty() {
            loop {
                let question = "Device URL of a thermometer, or none";
                let url = ask(input, output, question, "none")?;
                if url == "none" {
                    break;
                }
                let names = model.sensors().join(",");
                let names = ask(input, output, "Names of its sensors", &names)?;
                self.sensors.extend([url, names]);
            }
        }
        Ok(())
    }

    fn model(&self) -> Result<Model, GatewayError> {
        let machine = Machine::read(self.machine.as_deref().unwrap_or(Path::new("")))?;
        Ok(Model::new(&machine, Fading::default())?)
    }

    fn text(&self) -> Result<FirstText, GatewayError> {
        let model = self.model()?;
        let travel = model.axes.iter().copied();
        let travel: Vec<_> = travel.zip(model.travel.iter().copied()).collect();
        let axes = match &self.axes[..] {
            [] => &model.axes[..],
            stated => stated,
        };
        let machine = FirstMachine { axes, travel: &travel };
        let control = self.control.as_deref().unwrap_or_default();
        let of_call = |e: volcomp_port::DeviceError| GatewayError::invalid(e.to_string());
        let first = first_controller(control, &machine).map_err(of_call)?;
        let mut text = String::new();
        let header = format!(
            "# gateway file: what the gateway corrects. `volcomp-gateway check {}` shows what it means.\n",
            self.config.display()
        );
        let root = [
            Setting::text("machine", &self.machine_in_file(), "The machine file"),
            Setting::number("cycle_ms", first.cycle_ms, "Cycle period, ms: 0.25 to 100"),
            Setting::new("auto_arm", false, "Whether the gateway arms automatically"),
        ];
        add(&mut text, &header, &root);
        let is_rotary = axes.iter().any(|axis| axis.is_rotary());
        add(&mut text, "[guard]", &GuardTable::first(first.cycle_ms, is_rotary));
        add(&mut text, "[[controller]]", &first.settings);
        for pair in self.sensors.chunks(2) {
            let [url, names] = pair else { continue };
            let names = names.split(',').map(str::trim).map(str::to_owned);
            let names: Vec<String> = names.filter(|name| !name.is_empty()).collect();
            let settings = first_thermometer(url, &names).map_err(of_call)?;
            add(&mut text, "[[thermometer]]", &settings);
        }
        let dashboard = [
            Setting::text(
                "listen",
                "127.0.0.1:8080",
                "Address and port of the dashboard; others than this computer need TLS and tokens",
            ),
            Setting::text(
                "token_file",
                "tokens",
                "File of `volcomp-gateway token add`, if --token-file does not name it; the service reads its own",
            )
            .example(),
        ];
        add(&mut text, "[dashboard]", &dashboard);
        let audit = Setting::text("dir", "audit", "Folder of the audit log and the stored state");
        add(&mut text, "[audit]", &[audit]);
        Ok(FirstText { text, key_file: first.key_file })
    }

    /// Path of the machine file: relative to the folder of the configuration if the file is below it, otherwise
    /// absolute.
    fn machine_in_file(&self) -> String {
        let machine = self.machine.as_deref().unwrap_or(Path::new(""));
        let folder = self.config.parent().unwrap_or(Path::new(""));
        let relative = match machine.strip_prefix(folder) {
            Ok(below) => below.to_owned(),
            Err(_) => std::path::absolute(machine).unwrap_or_else(|_| machine.to_owned()),
        };
        relative.display().to_string()
    }
}

/// Adds a table: its header, and each key after the comment with its meaning.
fn add(text: &mut String, header: &str, settings: &[Setting]) {
    if !text.is_empty() {
        text.push('\n');
    }
    text.extend([header, "\n"]);
    for own in settings {
        let mark = if own.is_example { "# " } else { "" };
        text.extend(["# ", own.meaning, "\n", mark, own.key, " = ", &own.value, "\n"]);
    }
}

/// Asks a question. An empty answer selects the default; without a default the question is repeated.
fn ask(
    input: &mut impl BufRead,
    output: &mut impl Write,
    question: &str,
    default: &str,
) -> Result<String, GatewayError> {
    let failed = |e| GatewayError::system("terminal", e);
    loop {
        let shown = match default {
            "" => String::new(),
            default => format!(" [{default}]"),
        };
        write!(output, "{question}{shown}: ").and_then(|()| output.flush()).map_err(failed)?;
        let mut line = String::new();
        if input.read_line(&mut line).map_err(failed)? == 0 {
            return Err(GatewayError::invalid(format!(
                "the input ended before an answer to: {question}"
            )));
        }
        match line.trim() {
            "" if default.is_empty() => {}
            "" => return Ok(default.to_owned()),
            answer => return Ok(answer.to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn questions_take_defaults_and_answers() {
        let dir = tempfile::tempdir().expect("writable");
        let machine = dir.path().join("m.toml");
        let text = "name = \"m\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n";
        fs::write(&machine, text).expect("writable");
        let answers = format!(
            "{}\n\nfocas://192.0.2.10\n\nmodbus://192.0.2.20?profile=PTA8C04\nbed, column\n\n",
            machine.display()
        );
        let mut arguments = InitArguments::default();
        let mut asked = Vec::new();
        arguments.ask(&mut answers.as_bytes(), &mut asked).expect("answered");
        assert_eq!(arguments.control.as_deref(), Some("focas://192.0.2.10"));
        assert_eq!(arguments.axes, [AxisName::X, AxisName::Y, AxisName::Z]);
        assert_eq!(arguments.sensors, ["modbus://192.0.2.20?profile=PTA8C04", "bed, column"]);
        let asked = String::from_utf8(asked).expect("text");
        // The question without a default is repeated after an empty answer.
        assert_eq!(asked.matches("Device URL of the control").count(), 2);
        assert!(asked.contains("Corrected axes [X,Y,Z]: "), "{asked}");
        let ended = InitArguments::default().ask(&mut &b""[..], &mut Vec::new());
        let ended = ended.expect_err("no answer").to_string();
        assert!(ended.contains("Machine file"), "{ended}");
    }
}
