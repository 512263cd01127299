//! Reads the temperatures of a PT100 module.
//!
//!     cargo run -p volcomp-modbus --example thermometer -- 192.0.2.20:502 PTA8C04
//!
//! Without an address it uses a simulated module with one broken sensor wire.

use std::{
    error::Error,
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    time::{Duration, Instant},
};

use volcomp_modbus::{Bus, Profile, ThermometerConfig, ThermometerUnit, poll_temperatures};
use volcomp_port::{Quality, Reason, Thermometer};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let (address, profile) = match args.next() {
        Some(address) => (address, args.next().unwrap_or_else(|| "PTA8C04".to_owned())),
        None => (module()?, "WAGO-750-461".to_owned()),
    };
    let (host, port) =
        address.rsplit_once(':').ok_or("expected HOST:PORT, such as 192.0.2.20:502")?;
    let bus = Bus::Tcp { host: host.to_owned(), port: port.parse()? };
    let profile = Profile::named(&profile)?;
    let channels = profile.channels.as_ref().map_or(0, |c| c.count);
    let unit = ThermometerUnit {
        unit: 1,
        profile,
        names: (1..=channels).map(|n| format!("channel {n}")).collect(),
    };
    // A separate thread polls the module every second; `latest` returns the last response.
    let mut thermometer = poll_temperatures(ThermometerConfig::new(bus, unit))?;
    let end = Instant::now() + Duration::from_secs(5);
    let waits = |q: Quality| matches!(q, Quality::Bad(Reason::NotRead | Reason::NoAnswer));
    while thermometer.latest().iter().all(|t| waits(t.quality)) {
        if Instant::now() > end {
            return Err("the module does not answer".into());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let names = thermometer.names().to_vec();
    for (name, found) in names.iter().zip(thermometer.latest()) {
        match (found.degc, found.quality) {
            (Some(degc), _) => println!("{name}: {degc:.1} °C"),
            // The module reports a fault instead of a temperature.
            (None, Quality::Bad(reason)) => println!("{name}: {reason}"),
            (None, _) => println!("{name}: no temperature"),
        }
    }
    Ok(())
}

/// A simulated module with two channels: 21.5 °C, and the code of a broken wire.
fn module() -> Result<String, Box<dyn Error>> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?.to_string();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            // A connection may break; the client then connects again.
            let _ = answer(stream);
        }
    });
    Ok(address)
}

fn answer(mut stream: TcpStream) -> std::io::Result<()> {
    let registers = [215_u16, 8500];
    loop {
        // Request: transaction, protocol, length and unit, then function, first register and number of registers.
        let mut request = [0; 12];
        stream.read_exact(&mut request)?;
        let [high, low] = [request[10], request[11]];
        let count = usize::from(u16::from_be_bytes([high, low]));
        let words: Vec<u8> =
            registers.iter().cycle().take(count).flat_map(|word| word.to_be_bytes()).collect();
        let bytes = u8::try_from(words.len()).unwrap_or(u8::MAX);
        let mut answer = request[..4].to_vec();
        answer.extend([0, bytes + 3, request[6], request[7], bytes]);
        answer.extend(words);
        stream.write_all(&answer)?;
    }
}
