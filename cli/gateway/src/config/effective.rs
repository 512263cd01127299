//! The effective configuration: every key that has an effect, as a file would state it, with defaults marked.

use std::path::Path;

use serde_json::{Map, Value};
use volcomp_devices::config::{CONTROLLER_ONLY, uses};

use super::Config;
use crate::toml_text;

impl Config {
    /// Every key that has an effect, with its value, in the order of the manual.
    pub fn effective(&self) -> Map<String, Value> {
        // Decode the file again so that paths stay relative to its folder.
        let stated = self.source.document.clone();
        let stated = stated.and_then(|file| Self::decode(file, &self.file, Path::new("")).ok());
        let Ok(Value::Object(mut keys)) = serde_json::to_value(stated.as_ref().unwrap_or(self))
        else {
            return Map::new();
        };
        let controllers = keys.get_mut("controller").and_then(Value::as_array_mut);
        for (value, own) in controllers.into_iter().flatten().zip(&self.controllers) {
            if let (Some(table), Some(driver)) = (value.as_object_mut(), own.driver()) {
                let is_reader = own.axes.is_empty();
                let has_barrier = own.barrier.is_some();
                table.retain(|key, _| {
                    uses(driver, is_reader, key) && !(has_barrier && key == "unwatched")
                });
            }
        }
        let thermometers = keys.get_mut("thermometer").and_then(Value::as_array_mut);
        let thermometers = thermometers.into_iter().flatten();
        for own in thermometers.filter_map(Value::as_object_mut) {
            for table in own.values_mut().filter_map(Value::as_object_mut) {
                table.retain(|key, _| !CONTROLLER_ONLY.contains(&key.as_str()));
            }
        }
        if let Some(guard) = keys.get_mut("guard").and_then(Value::as_object_mut)
            && guard.get("limit_urad").is_some_and(Value::is_null)
        {
            guard.retain(|key, _| !key.ends_with("_urad"));
        }
        toml_text::without_empty(&mut keys);
        keys
    }

    /// Full names of the effective keys that the file does not state.
    pub fn defaults(&self) -> Vec<String> {
        let mut defaults = Vec::new();
        self.collect(&self.effective(), "", &mut defaults);
        defaults
    }

    fn collect(&self, table: &Map<String, Value>, above: &str, defaults: &mut Vec<String>) {
        for (key, value) in table {
            let key = format!("{above}{key}");
            match value {
                Value::Object(table) => self.collect(table, &format!("{key}."), defaults),
                Value::Array(items) if items.iter().any(Value::is_object) => {
                    for (index, item) in items.iter().enumerate() {
                        if let Value::Object(table) = item {
                            self.collect(table, &format!("{key}[{index}]."), defaults);
                        }
                    }
                }
                _ if self.source.states(&key) => {}
                _ => defaults.push(key),
            }
        }
    }

    /// The effective configuration as TOML; defaults are marked.
    pub fn effective_toml(&self) -> String {
        toml_text::marked(&self.effective(), &|key| !self.source.states(key))
    }
}
