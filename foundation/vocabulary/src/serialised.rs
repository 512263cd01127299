//! Serde format of the vocabulary types, and its JSON Schemas.
//!
//! Axis letters, error names and directions are serialised as text.

use core::{fmt, marker::PhantomData, str::FromStr};

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{Error, SeqAccess, Visitor},
};

use crate::{AxisKind, AxisName, Component, Direction, ErrorName, MAX_AXES, PerAxis, PerChannel};

struct Text<T>(PhantomData<T>, &'static str);

impl<T: FromStr<Err: fmt::Display>> Visitor<'_> for Text<T> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.1)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<T, E> {
        text.parse().map_err(E::custom)
    }
}

macro_rules! as_text {
    ($name:ident, $expected:literal) => {
        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                deserializer.deserialize_str(Text::<Self>(PhantomData, $expected))
            }
        }
    };
}

as_text!(AxisName, "an axis letter");
as_text!(ErrorName, "an error name such as EXX or EC0Y");
as_text!(Direction, "+ or -");

impl Serialize for AxisKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl Serialize for Component {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("E{}", self.letter()))
    }
}

/// Visitor that reads up to [`MAX_AXES`] values; missing values hold the default.
struct Values<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de> + Default> Visitor<'de> for Values<T> {
    type Value = [T; MAX_AXES];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "up to {MAX_AXES} values, one for each axis")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Self::Value, A::Error> {
        let mut values: [T; MAX_AXES] = core::array::from_fn(|_| T::default());
        let mut count = 0;
        while let Some(value) = sequence.next_element()? {
            let place =
                values.get_mut(count).ok_or_else(|| A::Error::invalid_length(count + 1, &self))?;
            *place = value;
            count += 1;
        }
        Ok(values)
    }
}

macro_rules! as_sequence {
    ($($name:ident),*) => {$(
        impl<T: Serialize> Serialize for $name<T> {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                self.0.serialize(serializer)
            }
        }

        impl<'de, T: Deserialize<'de> + Default> Deserialize<'de> for $name<T> {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                deserializer.deserialize_seq(Values(PhantomData)).map(Self)
            }
        }
    )*};
}

as_sequence!(PerAxis, PerChannel);

#[cfg(feature = "schema")]
mod schema {
    extern crate std;

    use std::borrow::Cow;

    use schemars::{JsonSchema, Schema, SchemaGenerator};

    use crate::{
        AxisKind, AxisName, Component, Deg, Degc, Direction, ErrorName, Mm, Rad, Um, Urad,
    };

    macro_rules! as_schema_of {
        ($plain:ty: $($name:ident),*) => {$(
            impl JsonSchema for $name {
                fn inline_schema() -> bool {
                    true
                }

                fn schema_name() -> Cow<'static, str> {
                    <$plain>::schema_name()
                }

                fn json_schema(generator: &mut SchemaGenerator) -> Schema {
                    <$plain>::json_schema(generator)
                }
            }
        )*};
    }

    as_schema_of!(str: AxisKind, AxisName, Component, Direction, ErrorName);
    as_schema_of!(f64: Mm, Um, Deg, Rad, Urad, Degc);
}
