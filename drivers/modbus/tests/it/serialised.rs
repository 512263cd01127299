//! Profiles and buses through serde: what is written is read as it was.

use volcomp_modbus::{Bus, Parity, Profile, ThermometerConfig, ThermometerUnit};

#[test]
fn what_is_written_is_read_as_it_was() {
    for profile in Profile::shipped() {
        let text = serde_json::to_string(&profile).unwrap();
        let read: Profile = serde_json::from_str(&text).unwrap();
        assert_eq!(read, profile, "{text}");
    }
    for bus in [
        Bus::Tcp {
            host: "192.0.2.20".to_owned(),
            port: 502,
        },
        Bus::Rtu {
            path: "/dev/ttyUSB0".to_owned(),
            baud: 19200,
            parity: Parity::Even,
            stop_bits: 1,
        },
    ] {
        let unit = ThermometerUnit {
            unit: 3,
            profile: Profile::named("PTA8C04").unwrap(),
            names: vec!["bed".to_owned()],
        };
        let config = ThermometerConfig::new(bus, unit);
        let text = serde_json::to_string(&config).unwrap();
        let read: ThermometerConfig = serde_json::from_str(&text).unwrap();
        assert_eq!(read, config, "{text}");
    }
}
