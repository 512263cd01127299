//! Measurement file of a line: format, header, text.

use volcomp_metrology::{
    DeviationUnit, Environment, Measurement, Metadata, MotionKind, Quantity, StartEnd, write_csv,
    write_keysight_report, write_pos, write_renishaw,
};

use crate::shop::{Format, Header, Shop, ShopLine};

impl Format {
    pub(crate) const NAMES: [(&'static str, Self); 4] = [
        ("renishaw", Self::Renishaw),
        ("csv", Self::Csv),
        ("api-pos", Self::ApiPos),
        ("keysight-report", Self::KeysightReport),
    ];

    /// File extension of a format, for angles or lengths, with or without straightness optics.
    fn ending(self, holds_angles: bool, straightness: bool) -> &'static str {
        match (self, holds_angles, straightness) {
            (Self::Csv, ..) => "csv",
            (Self::ApiPos, ..) => "pos",
            (Self::KeysightReport, ..) => "txt",
            (Self::Renishaw, true, _) => "rta",
            (Self::Renishaw, false, true) => "rts",
            (Self::Renishaw, false, false) => "rtl",
        }
    }

    /// Reason why a line cannot be written in this format; `None` if it can.
    pub(crate) fn refuses(self, line: &ShopLine) -> Option<&'static str> {
        match self {
            Self::ApiPos if line.setup.reads_angles() => {
                Some("`api-pos` holds lengths, expected another format for angles")
            }
            Self::KeysightReport if !line.instrument.both_directions => Some(
                "`keysight-report` holds both directions in each row, expected `both_directions = true`",
            ),
            _ => None,
        }
    }
}

impl Header {
    fn environment(&self) -> Environment {
        let constant = |value: Option<f64>, unit_code| {
            value.map(|value| StartEnd { start: value, end: value, unit_code })
        };
        Environment {
            air_temperature: constant(self.air_degc, Some(0)),
            material_temperature: [constant(self.material_degc, Some(0)), None, None],
            expansion_coefficient: constant(self.expansion_um_per_m_k, None),
            ..Environment::default()
        }
    }
}

impl ShopLine {
    pub(crate) fn file_name(&self) -> String {
        let straightness = MotionKind::of(self.setup.error) == MotionKind::Straightness;
        let ending = self.format.ending(self.setup.reads_angles(), straightness);
        format!("{}.{ending}", self.name)
    }
}

impl Shop {
    pub(crate) fn measurement_file(
        &self,
        line: &ShopLine,
        measurement: &Measurement,
    ) -> (String, String) {
        let header = &self.header;
        let error = line.setup.error;
        let holds_angles = measurement.unit == Some(DeviationUnit::Urad);
        let straightness = MotionKind::of(error) == MotionKind::Straightness && !holds_angles;
        let described = Measurement {
            quantity: straightness.then_some(Quantity::Straightness),
            metadata: Metadata {
                machine: Some(self.truth.name.clone()),
                axis: Some(error.axis.to_string()),
                title: Some(error.to_string()),
                date: header.date.clone(),
                by: header.by.clone(),
                serial: header.serial.clone(),
                location: header.location.clone(),
                ..Metadata::default()
            },
            environment: header.environment(),
            ..measurement.clone()
        };
        let text = match line.format {
            Format::Csv => write_csv(&described),
            Format::Renishaw => write_renishaw(&described),
            Format::ApiPos => write_pos(&described),
            Format::KeysightReport => write_keysight_report(&described),
        };
        (line.file_name(), text)
    }
}
