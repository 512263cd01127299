//! Finds a number in an answer that is not finite: JSON would write it as null, and no table means it.

use std::fmt;

use serde::ser::{self, Impossible, Serialize};

/// The key of the first number that is NaN or infinite; `None` where all are finite.
pub(crate) fn first_not_finite(document: &impl Serialize) -> Option<String> {
    document.serialize(Finite).err().map(|found| found.key)
}

struct Finite;

#[derive(Debug)]
struct NotFinite {
    key: String,
}

impl NotFinite {
    /// The same below a key.
    fn below(self, key: &str) -> Self {
        let dot = if self.key.is_empty() || self.key.starts_with('[') {
            ""
        } else {
            "."
        };
        Self {
            key: format!("{key}{dot}{}", self.key),
        }
    }
}

impl fmt::Display for NotFinite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.key)
    }
}

impl std::error::Error for NotFinite {}

impl ser::Error for NotFinite {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self {
            key: message.to_string(),
        }
    }
}

macro_rules! accepted {
    ($($name:ident: $kind:ty),*) => {
        $(fn $name(self, _: $kind) -> Result<(), NotFinite> { Ok(()) })*
    };
}

impl ser::Serializer for Finite {
    type Ok = ();
    type Error = NotFinite;
    type SerializeSeq = Items;
    type SerializeTuple = Items;
    type SerializeTupleStruct = Items;
    type SerializeTupleVariant = Impossible<(), NotFinite>;
    type SerializeMap = Entries;
    type SerializeStruct = Entries;
    type SerializeStructVariant = Entries;

    accepted! {
        serialize_bool: bool, serialize_i8: i8, serialize_i16: i16, serialize_i32: i32, serialize_i64: i64,
        serialize_u8: u8, serialize_u16: u16, serialize_u32: u32, serialize_u64: u64, serialize_char: char,
        serialize_str: &str, serialize_bytes: &[u8], serialize_unit_struct: &'static str
    }

    fn serialize_f32(self, value: f32) -> Result<(), NotFinite> {
        self.serialize_f64(f64::from(value))
    }

    fn serialize_f64(self, value: f64) -> Result<(), NotFinite> {
        if value.is_finite() {
            Ok(())
        } else {
            Err(NotFinite { key: String::new() })
        }
    }

    fn serialize_none(self) -> Result<(), NotFinite> {
        Ok(())
    }

    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), NotFinite> {
        value.serialize(self)
    }

    fn serialize_unit(self) -> Result<(), NotFinite> {
        Ok(())
    }

    fn serialize_unit_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
    ) -> Result<(), NotFinite> {
        Ok(())
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<(), NotFinite> {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        value: &T,
    ) -> Result<(), NotFinite> {
        value.serialize(self).map_err(|found| found.below(variant))
    }

    fn serialize_seq(self, _: Option<usize>) -> Result<Items, NotFinite> {
        Ok(Items { place: 0 })
    }

    fn serialize_tuple(self, _: usize) -> Result<Items, NotFinite> {
        Ok(Items { place: 0 })
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Items, NotFinite> {
        Ok(Items { place: 0 })
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        _: usize,
    ) -> Result<Self::SerializeTupleVariant, NotFinite> {
        Err(ser::Error::custom(variant))
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Entries, NotFinite> {
        Ok(Entries::default())
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Entries, NotFinite> {
        Ok(Entries::default())
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Entries, NotFinite> {
        Ok(Entries::default())
    }
}

/// State: the items of a list.
struct Items {
    place: usize,
}

impl Items {
    fn item<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotFinite> {
        let place = self.place;
        self.place += 1;
        value
            .serialize(Finite)
            .map_err(|found| found.below(&format!("[{place}]")))
    }
}

/// State: the entries of a map or struct.
#[derive(Default)]
struct Entries {
    key: String,
}

impl Entries {
    fn entry<T: Serialize + ?Sized>(key: &str, value: &T) -> Result<(), NotFinite> {
        value.serialize(Finite).map_err(|found| found.below(key))
    }
}

macro_rules! list {
    ($name:ident, $item:ident) => {
        impl ser::$name for Items {
            type Ok = ();
            type Error = NotFinite;

            fn $item<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotFinite> {
                self.item(value)
            }

            fn end(self) -> Result<(), NotFinite> {
                Ok(())
            }
        }
    };
}

list!(SerializeSeq, serialize_element);
list!(SerializeTuple, serialize_element);
list!(SerializeTupleStruct, serialize_field);

macro_rules! fields {
    ($name:ident) => {
        impl ser::$name for Entries {
            type Ok = ();
            type Error = NotFinite;

            fn serialize_field<T: Serialize + ?Sized>(
                &mut self,
                key: &'static str,
                value: &T,
            ) -> Result<(), NotFinite> {
                Self::entry(key, value)
            }

            fn end(self) -> Result<(), NotFinite> {
                Ok(())
            }
        }
    };
}

fields!(SerializeStruct);
fields!(SerializeStructVariant);

impl ser::SerializeMap for Entries {
    type Ok = ();
    type Error = NotFinite;

    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), NotFinite> {
        self.key = match serde_json::to_value(key) {
            Ok(serde_json::Value::String(key)) => key,
            Ok(other) => other.to_string(),
            Err(_) => String::new(),
        };
        Ok(())
    }

    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), NotFinite> {
        Self::entry(&self.key, value)
    }

    fn end(self) -> Result<(), NotFinite> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::first_not_finite;

    #[derive(serde::Serialize)]
    #[serde(untagged)]
    enum Shape {
        Plain(f64),
        Named { value: Option<f64> },
    }

    #[derive(serde::Serialize)]
    struct Document {
        name: &'static str,
        shapes: Vec<Shape>,
        by_axis: BTreeMap<String, [f64; 2]>,
    }

    #[test]
    fn the_first_number_that_is_not_finite_is_named() {
        let document = |shape: f64, named: Option<f64>, axis: f64| Document {
            name: "NaN",
            shapes: vec![Shape::Plain(shape), Shape::Named { value: named }],
            by_axis: BTreeMap::from([("X".to_owned(), [0.0, axis])]),
        };
        let cases = [
            (document(1.0, None, 2.0), None),
            (document(f64::NAN, None, 2.0), Some("shapes[0]")),
            (
                document(1.0, Some(f64::INFINITY), 2.0),
                Some("shapes[1].value"),
            ),
            (
                document(1.0, Some(0.0), f64::NEG_INFINITY),
                Some("by_axis.X[1]"),
            ),
        ];
        for (document, key) in cases {
            assert_eq!(first_not_finite(&document).as_deref(), key);
        }
    }
}
