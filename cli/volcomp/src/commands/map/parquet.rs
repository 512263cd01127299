//! The field of a map as Apache Parquet: one row per node, one row group per chunk.

use std::{path::Path, sync::Arc};

use parquet::{
    basic::{Repetition, Type as Physical},
    data_type::DoubleType,
    errors::ParquetError,
    file::{properties::WriterProperties, writer::SerializedFileWriter},
    schema::types::Type,
};
use volcomp_model::MapGrid;

use super::field::Node;
use crate::{failure::Failure, output::OutputFile};

pub(super) struct ParquetField {
    writer: SerializedFileWriter<OutputFile>,
    axes: usize,
    columns: usize,
    path: String,
}

impl ParquetField {
    pub(super) fn open(path: &Path, grid: &MapGrid, columns: &[&str]) -> Result<Self, Failure> {
        let shown = path.display().to_string();
        let axes = grid.axes.iter().map(|name| format!("{name}_mm"));
        let names = axes.chain(columns.iter().map(ToString::to_string));
        let field = |name: String| {
            let number = Type::primitive_type_builder(&name, Physical::DOUBLE);
            let number = number.with_repetition(Repetition::REQUIRED).build();
            number.map(Arc::new)
        };
        let schema = names
            .map(field)
            .collect::<Result<Vec<_>, _>>()
            .and_then(|fields| Type::group_type_builder("map").with_fields(fields).build())
            .map_err(|e| failed(&shown, &e))?;
        let file = OutputFile::open(path)?;
        let properties = Arc::new(WriterProperties::builder().build());
        Ok(Self {
            writer: SerializedFileWriter::new(file, Arc::new(schema), properties)
                .map_err(|e| failed(&shown, &e))?,
            axes: grid.axes.len(),
            columns: columns.len(),
            path: shown,
        })
    }

    pub(super) fn write(&mut self, nodes: &[Node]) -> Result<(), Failure> {
        let path = self.path.clone();
        self.write_group(nodes).map_err(|e| failed(&path, &e))
    }

    fn write_group(&mut self, nodes: &[Node]) -> Result<(), ParquetError> {
        let mut group = self.writer.next_row_group()?;
        for column in 0..self.axes + self.columns {
            let number = |node: &Node| match column.checked_sub(self.axes) {
                None => node.at_mm[column],
                Some(error @ 0..6) => node.in_file_units()[error],
                Some(other) => node.uncertainty_in_file_units()[other - 6],
            };
            let numbers: Vec<f64> = nodes.iter().map(number).collect();
            if let Some(mut writer) = group.next_column()? {
                let typed = writer.typed::<DoubleType>();
                typed.write_batch(&numbers, None, None)?;
                writer.close()?;
            }
        }
        group.close()?;
        Ok(())
    }

    pub(super) fn finish(self: Box<Self>) -> Result<(), Failure> {
        let file = self.writer.into_inner();
        file.map_err(|e| failed(&self.path, &e))?.finish()
    }
}

fn failed(path: &str, error: &ParquetError) -> Failure {
    Failure::Work(format!("{path}: {error}"))
}
