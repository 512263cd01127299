//! JSON Schemas of the vocabulary types as serialised by serde.

extern crate std;

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator};

use crate::{AxisKind, AxisName, Component, Deg, Degc, Direction, ErrorName, Mm, Rad, Um, Urad};

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
