//! Binary format of a compiled machine, which the gateway reads and which can be distributed.
//!
//! Layout: the signature `VOLCOMPM`, the version, the SHA-256 of the remaining bytes, the machine. Numbers are
//! little-endian.

use alloc::{string::ToString, vec::Vec};

use arrayvec::ArrayVec;
use sha2::{Digest, Sha256};
use volcomp_kinematics::{Chain, ErrorMotion, MotionFrame, Structure, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, AxisName, Component, MAX_AXES, PerAxis};

use crate::{
    EvaluatorError, Tolerance,
    build::{AxisTables, Frame},
    error::BlobError,
    machine::{CompiledAxis, CompiledMachine, Range, Thermal},
    parts::Branches,
    table::{CompiledPatch, LANES, MAX_PIECES, Patch, Piece},
};

/// Format version that is written. Older versions can still be read: version 3, in which the error motions of every
/// rotary axis are in the non-rotating frame, and version 2, which also lacks thermal offsets.
pub const BLOB_VERSION: u32 = 4;

const OLDEST_VERSION: u32 = 2;

const MAGIC: &[u8; 8] = b"VOLCOMPM";
const HEAD: usize = 8 + 4 + 32;
const MAX_NODES: usize = 1 << 16;

impl CompiledMachine {
    /// Serialises the machine, including the correcting axes and the current thermal offsets.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut body = Vec::new();
        let structure = self.chain.structure().to_string();
        put_count(&mut body, structure.len());
        body.extend(structure.as_bytes());
        put(&mut body, self.chain.tool_tip_mm().iter());
        put(&mut body, self.chain.tool_axis().iter());
        put(&mut body, self.chain.workpiece_origin_mm().iter());
        put(&mut body, &[self.tolerance.linear_mm, self.tolerance.angular_rad]);
        for (index, axis) in self.axes.iter().enumerate() {
            put_axis(&mut body, self, index, axis);
        }
        put_count(&mut body, self.ranges.len());
        for range in &self.ranges {
            put_count(&mut body, range.axis);
            put_count(&mut body, range.component.index());
            put_count(&mut body, range.looked_at);
            put(&mut body, &range.domain);
        }
        put_count(&mut body, self.may_move.len());
        for name in &self.may_move {
            // The fallback is never used: every axis that may move is an axis of the chain.
            put_count(&mut body, self.chain.structure().index_of(*name).unwrap_or(0));
        }
        for axis in &self.axes {
            put(&mut body, axis.thermal.at_tip.iter().chain(&axis.thermal.slope_mm));
        }
        for axis in &self.axes {
            put_count(&mut body, usize::from(axis.joint.motion_frame == MotionFrame::Turning));
        }
        let mut blob = Vec::with_capacity(HEAD + body.len());
        blob.extend(MAGIC);
        blob.extend(BLOB_VERSION.to_le_bytes());
        blob.extend(Sha256::digest(&body));
        blob.extend(body);
        blob
    }

    /// Reads a machine from the bytes that [`to_blob`](Self::to_blob) wrote.
    ///
    /// # Errors
    /// [`EvaluatorError::Blob`]: not a blob, another version, a wrong checksum, invalid content.
    pub fn from_blob(blob: &[u8]) -> Result<Self, EvaluatorError> {
        let (head, body) = blob.split_at_checked(HEAD).ok_or(BlobError::CutOff)?;
        if &head[..8] != MAGIC {
            return Err(BlobError::NotABlob.into());
        }
        let version = u32::from_le_bytes([head[8], head[9], head[10], head[11]]);
        if !(OLDEST_VERSION..=BLOB_VERSION).contains(&version) {
            return Err(BlobError::Version { found: version, expected: BLOB_VERSION }.into());
        }
        if Sha256::digest(body)[..] != head[12..] {
            return Err(BlobError::Checksum.into());
        }
        read_machine(&mut Reader { body }, version)
    }
}

fn put<'a>(body: &mut Vec<u8>, numbers: impl IntoIterator<Item = &'a f64>) {
    for number in numbers {
        body.extend(number.to_le_bytes());
    }
}

fn put_count(body: &mut Vec<u8>, count: usize) {
    body.extend((count as u64).to_le_bytes());
}

fn put_motion(body: &mut Vec<u8>, motion: &ErrorMotion) {
    put(body, motion.linear_mm.iter().chain(motion.angular_rad.iter()));
}

fn put_axis(body: &mut Vec<u8>, machine: &CompiledMachine, index: usize, axis: &CompiledAxis) {
    put(body, axis.joint.direction.iter().chain(axis.joint.point_mm.iter()));
    put_motion(body, &machine.location[index]);
    put_motion(body, &machine.assembly[index]);
    // A period of 0 means no modulo.
    let [low, high] = axis.travel;
    put(body, &[low, high, axis.modulo.unwrap_or(0.0)]);
    let heads = match axis.branches {
        Branches::One => &axis.heads[..1],
        Branches::Three => &axis.heads[..],
    };
    put_count(body, heads.len());
    for head in heads {
        let pieces = machine.tables.pieces(head);
        put_count(body, pieces.len());
        for piece in pieces {
            put(body, &[piece.start(), piece.end()]);
            for power in 0..4 {
                put(body, &piece.power(power));
            }
        }
    }
    put_count(body, axis.patches.len());
    for CompiledPatch { patch, looked_at, .. } in &axis.patches {
        put_count(body, patch.component.index());
        put(body, &patch.weights);
        for (axis, nodes) in looked_at.iter().zip(&patch.nodes) {
            put_count(body, *axis);
            put_count(body, nodes.len());
            put(body, nodes);
        }
        put(body, &patch.values);
    }
}

fn senseless(found: &'static str) -> BlobError {
    BlobError::Content { found }
}

struct Reader<'a> {
    body: &'a [u8],
}

impl Reader<'_> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], BlobError> {
        let (first, rest) = self.body.split_first_chunk::<N>().ok_or(BlobError::CutOff)?;
        self.body = rest;
        Ok(*first)
    }

    fn number(&mut self) -> Result<f64, BlobError> {
        Some(f64::from_le_bytes(self.bytes()?))
            .filter(|number| number.is_finite())
            .ok_or(BlobError::NotFinite)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], BlobError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number()?;
        }
        Ok(numbers)
    }

    fn list(&mut self, count: usize) -> Result<Vec<f64>, BlobError> {
        (0..count).map(|_| self.number()).collect()
    }

    fn count(&mut self, most: usize, what: &'static str) -> Result<usize, BlobError> {
        let found = u64::from_le_bytes(self.bytes()?);
        usize::try_from(found).ok().filter(|count| *count <= most).ok_or(BlobError::TooMany {
            what,
            found,
            most,
        })
    }

    fn component(&mut self) -> Result<Component, BlobError> {
        let index = self.count(LANES - 1, "as a component")?;
        Component::ALL.get(index).copied().ok_or_else(|| senseless("no component"))
    }

    fn motion(&mut self) -> Result<ErrorMotion, BlobError> {
        let [x, y, z, a, b, c] = self.numbers()?;
        Ok(ErrorMotion { linear_mm: Vector3::new(x, y, z), angular_rad: Vector3::new(a, b, c) })
    }
}

fn read_machine(reader: &mut Reader<'_>, version: u32) -> Result<CompiledMachine, EvaluatorError> {
    let length = reader.count(100, "letters of structure")?;
    let (text, rest) = reader.body.split_at_checked(length).ok_or(BlobError::CutOff)?;
    reader.body = rest;
    let structure: Structure = core::str::from_utf8(text)
        .ok()
        .and_then(|text| text.parse().ok())
        .ok_or_else(|| senseless("no structure"))?;
    let mut chain = Chain::new(structure.clone());
    let (tip, tool_axis, origin) = (reader.numbers()?, reader.numbers()?, reader.numbers()?);
    let [linear_mm, angular_rad] = reader.numbers()?;
    chain.set_tool(tip, tool_axis).map_err(BlobError::Chain)?;
    chain.set_workpiece_origin(origin).map_err(BlobError::Chain)?;
    let (mut axes, mut location, mut assembly) =
        (Vec::new(), PerAxis::default(), PerAxis::default());
    for (index, &name) in structure.axes().iter().enumerate() {
        let (direction, point) = (reader.numbers()?, reader.numbers()?);
        chain.set_direction(name, direction).map_err(BlobError::Chain)?;
        chain.set_point(name, point).map_err(BlobError::Chain)?;
        (location[index], assembly[index]) = (reader.motion()?, reader.motion()?);
        axes.push(read_axis(reader, name, &structure)?);
    }
    let mut ranges = Vec::new();
    let last = structure.axes().len() - 1;
    for _ in 0..reader.count(MAX_NODES, "ranges")? {
        ranges.push(Range {
            axis: reader.count(last, "as an axis")?,
            component: reader.component()?,
            looked_at: reader.count(last, "as an axis")?,
            domain: reader.numbers()?,
        });
    }
    let mut moved = ArrayVec::<AxisName, MAX_AXES>::new();
    for _ in 0..reader.count(structure.axes().len(), "axes that correct")? {
        let name = structure.axes()[reader.count(last, "as an axis")?];
        moved.push(name); // at most as many as the structure has
    }
    let mut thermal = Vec::new();
    // Version 2 has no thermal offsets.
    for _ in structure.axes().iter().filter(|_| version >= 3) {
        thermal.push(Thermal { at_tip: reader.numbers()?, slope_mm: reader.numbers()? });
    }
    // Versions 2 and 3 have no motion frames.
    for &name in structure.axes().iter().filter(|_| version >= 4) {
        if reader.count(1, "as a motion frame")? == 1 {
            chain.set_motion_frame(name, MotionFrame::Turning).map_err(BlobError::Chain)?;
        }
    }
    if !reader.body.is_empty() {
        return Err(BlobError::TooLong.into());
    }
    let tolerance = Tolerance { linear_mm, angular_rad };
    let frame = Frame::new(chain, &location, &assembly, tolerance);
    let mut machine = CompiledMachine::from_tables(frame, axes, ranges);
    machine.set_correctors(&moved)?;
    for (axis, thermal) in machine.axes.iter_mut().zip(thermal) {
        axis.thermal = thermal;
    }
    machine.choose_path();
    Ok(machine)
}

fn read_axis(
    reader: &mut Reader<'_>,
    name: AxisName,
    structure: &Structure,
) -> Result<AxisTables, BlobError> {
    let [low, high, period] = reader.numbers()?;
    if low >= high || period < 0.0 || (period > 0.0 && name.kind() == AxisKind::Linear) {
        return Err(senseless("a travel or a modulo that makes no axis"));
    }
    let count = reader.count(3, "tables")?;
    if count != 1 && count != 3 {
        return Err(senseless("another number of tables than one or three"));
    }
    let tables = (0..count).map(|_| read_table(reader)).collect::<Result<_, _>>()?;
    let count = reader.count(MAX_NODES, "patches")?;
    let patches = (0..count).map(|_| read_patch(reader, structure)).collect::<Result<_, _>>()?;
    Ok(AxisTables {
        travel: [low, high],
        modulo: (period > 0.0).then_some(period),
        tables,
        patches,
    })
}

fn read_table(reader: &mut Reader<'_>) -> Result<Vec<Piece>, BlobError> {
    let count = reader.count(MAX_PIECES, "pieces")?;
    let mut pieces: Vec<Piece> = Vec::new();
    for place in 0..count {
        let [start, end] = reader.numbers()?;
        let joins = pieces.last().is_none_or(|before| before.end() == start);
        // The first and the last piece are constant at the end values.
        let held = place == 0 || place + 1 == count;
        if !joins || (start >= end) != held || start > end {
            return Err(senseless("pieces that do not follow one another"));
        }
        let mut powers = [[0.0; LANES]; 4];
        for power in &mut powers {
            *power = reader.numbers()?;
        }
        pieces.push(Piece::new(start, end, powers));
    }
    if pieces.len() < 2 {
        return Err(senseless("a table without ends"));
    }
    Ok(pieces)
}

fn read_patch(reader: &mut Reader<'_>, structure: &Structure) -> Result<CompiledPatch, BlobError> {
    let component = reader.component()?;
    let weights = reader.numbers()?;
    let mut looked_at = [0; 2];
    let mut nodes = [Vec::new(), Vec::new()];
    for (axis, nodes) in looked_at.iter_mut().zip(&mut nodes) {
        *axis = reader.count(structure.axes().len() - 1, "as an axis")?;
        let count = reader.count(MAX_NODES, "nodes")?;
        *nodes = reader.list(count)?;
        if nodes.is_empty() || nodes.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(senseless("nodes that do not rise"));
        }
    }
    let values = reader.list(nodes[0].len() * nodes[1].len())?;
    let patch = Patch {
        component,
        weights,
        axes: looked_at.map(|index| structure.axes()[index]),
        nodes,
        values,
    };
    Ok(CompiledPatch::new(patch, looked_at))
}
