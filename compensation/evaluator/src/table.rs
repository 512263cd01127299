//! The six errors of an axis as piecewise cubics over one coordinate.

use alloc::vec::Vec;

use volcomp_kinematics::nalgebra::Vector3;

use crate::index::{Cell, Uniform};

/// Number of components of a twist: three translations, three rotations.
pub(crate) const LANES: usize = 6;
/// Number of lanes of a vector register to which the components are padded.
pub(crate) const WIDE: usize = 8;
/// Maximum number of pieces of a table, 1 MiB.
pub(crate) const MAX_PIECES: usize = (1 << 20) / size_of::<Piece>();

/// Cubics of all components over one interval: c0, c1, c2, c3, each a cache line with the components side by side. The two spare lanes of
/// the first row hold the start and the end of the interval.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Piece {
    rows: [[f64; WIDE]; 4],
}

impl Piece {
    /// A piece from its coefficients of powers of the distance from `start`; `end` is the start of the next piece.
    pub(crate) fn new(start: f64, end: f64, powers: [[f64; LANES]; 4]) -> Self {
        let mut rows = [[0.0; WIDE]; 4];
        for (row, power) in rows.iter_mut().zip(powers) {
            row[..LANES].copy_from_slice(&power);
        }
        rows[0][LANES] = start;
        rows[0][LANES + 1] = end;
        Self { rows }
    }

    /// A constant piece on one side of `x`.
    pub(crate) fn held(x: f64, value: [f64; LANES]) -> Self {
        let nothing = [0.0; LANES];
        Self::new(x, x, [value, nothing, nothing, nothing])
    }

    pub(crate) fn start(&self) -> f64 {
        self.rows[0][LANES]
    }

    pub(crate) fn end(&self) -> f64 {
        self.rows[0][LANES + 1]
    }

    /// The coefficient of a power of the distance from the start, for every component.
    pub(crate) fn power(&self, power: usize) -> [f64; LANES] {
        core::array::from_fn(|lane| self.rows[power][lane])
    }

    /// Adds `slope_mm` per unit of the coordinate to the displacements.
    pub(crate) fn add_slope(&mut self, slope_mm: &Vector3<f64>) {
        let start = self.start();
        for lane in 0..3 {
            self.rows[0][lane] += slope_mm[lane] * start;
            self.rows[1][lane] += slope_mm[lane];
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Head {
    index: Uniform,
    from_piece: u32,
    pieces: u32,
}

/// All tables of a machine: pieces and the uniform indices over them. The first and the last piece of a table extend to infinity.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tables {
    cells: Vec<Cell>,
    pieces: Vec<Piece>,
}

pub(crate) trait Registers: Copy {
    /// Values of all components of a table at `x`; the two padding lanes are undefined.
    fn value(self, tables: &Tables, head: &Head, x: f64) -> [f64; WIDE];

    fn sum(self, a: &[f64; WIDE], b: &[f64; WIDE]) -> [f64; WIDE];

    /// `a`·`b` + `c`, fused if the processor does it fast.
    fn mul_add(self, a: f64, b: f64, c: f64) -> f64;
}

#[derive(Clone, Copy)]
pub(crate) struct Baseline;

impl Registers for Baseline {
    #[inline(always)]
    fn value(self, tables: &Tables, head: &Head, x: f64) -> [f64; WIDE] {
        let (piece, t) = tables.piece(head, x);
        let [c0, c1, c2, c3] = &piece.rows;
        core::array::from_fn(|lane| c0[lane] + t * (c1[lane] + t * (c2[lane] + t * c3[lane])))
    }

    #[inline(always)]
    fn sum(self, a: &[f64; WIDE], b: &[f64; WIDE]) -> [f64; WIDE] {
        core::array::from_fn(|lane| a[lane] + b[lane])
    }

    #[inline(always)]
    fn mul_add(self, a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
}

#[cfg(feature = "std")]
#[derive(Clone, Copy)]
pub(crate) struct Wide<S>(pub(crate) S);

#[cfg(feature = "std")]
impl<S: pulp::Simd> Registers for Wide<S> {
    #[inline(always)]
    fn value(self, tables: &Tables, head: &Head, x: f64) -> [f64; WIDE] {
        let simd = self.0;
        let (piece, t) = tables.piece(head, x);
        let t = simd.splat_f64s(t);
        let [c0, c1, c2, c3] = piece.rows.each_ref().map(|row| S::as_simd_f64s(row).0);
        let mut value = [0.0; WIDE];
        let registers = S::as_mut_simd_f64s(&mut value).0;
        for (lane, register) in registers.iter_mut().enumerate() {
            let high = simd.mul_add_e_f64s(c3[lane], t, c2[lane]);
            let middle = simd.mul_add_e_f64s(high, t, c1[lane]);
            *register = simd.mul_add_e_f64s(middle, t, c0[lane]);
        }
        value
    }

    #[inline(always)]
    fn sum(self, a: &[f64; WIDE], b: &[f64; WIDE]) -> [f64; WIDE] {
        let mut sum = [0.0; WIDE];
        let registers = S::as_mut_simd_f64s(&mut sum).0;
        let (a, b) = (S::as_simd_f64s(a).0, S::as_simd_f64s(b).0);
        for (lane, register) in registers.iter_mut().enumerate() {
            *register = self.0.add_f64s(a[lane], b[lane]);
        }
        sum
    }

    #[inline(always)]
    fn mul_add(self, a: f64, b: f64, c: f64) -> f64 {
        // Every x86 processor with four lanes has fused multiply-add; on others `mul_add` would be a function call.
        if cfg!(any(target_arch = "x86_64", target_arch = "x86")) && S::F64_LANES >= 4 {
            a.mul_add(b, c)
        } else {
            a * b + c
        }
    }
}

impl Tables {
    /// Adds a table from its pieces, at least two. Each piece begins where the previous one ends. The first and the
    /// last piece have zero length and extend to infinity.
    #[expect(clippy::cast_possible_truncation, reason = "4096 pieces a table at most")]
    pub(crate) fn add(&mut self, pieces: &[Piece]) -> Head {
        let breakpoints: Vec<f64> = pieces[1..].iter().map(Piece::start).collect();
        let from_piece = self.pieces.len();
        self.pieces.extend(pieces);
        Head {
            index: Uniform::add(&mut self.cells, &breakpoints, from_piece),
            from_piece: from_piece as u32,
            pieces: pieces.len() as u32,
        }
    }

    pub(crate) fn pieces(&self, head: &Head) -> &[Piece] {
        &self.pieces[head.from_piece as usize..][..head.pieces as usize]
    }

    pub(crate) fn len(&self) -> usize {
        self.pieces.len()
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.pieces[..]) + size_of_val(&self.cells[..])
    }

    /// The piece at `x` and the distance from its start.
    #[inline(always)]
    fn piece(&self, head: &Head, x: f64) -> (&Piece, f64) {
        let cell = &self.cells[head.index.cell(x)];
        let mut place = cell.first as usize + usize::from(x >= cell.split);
        for _ in 0..cell.more {
            place += usize::from(x >= self.pieces[place].end());
        }
        let piece = &self.pieces[place];
        (piece, x - piece.start())
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Bounds {
    /// Maximum |slope| of each component, at the reference point of the axis instead of the tool tip, without the
    /// constant slope.
    pub(crate) slopes: [f64; LANES],
    /// Bound on the displacement of the tool tip, mm.
    pub(crate) linear_mm: f64,
    /// Bound on the tilt, rad.
    pub(crate) angular_rad: f64,
}

impl Bounds {
    /// Bounds over `pieces`, which state the errors at the tool tip. `arm_mm` leads from the reference point of the
    /// axis to the tool tip at machine zero; `slide` is the constant slope.
    pub(crate) fn of<'a>(
        pieces: impl Iterator<Item = &'a Piece>,
        arm_mm: &Vector3<f64>,
        slide: &Vector3<f64>,
    ) -> Self {
        let mut bounds = Self::default();
        for piece in pieces {
            bounds.take_slopes(piece, arm_mm, slide);
            bounds.take_sizes(piece);
        }
        bounds
    }

    fn take_slopes(&mut self, piece: &Piece, arm_mm: &Vector3<f64>, slide: &Vector3<f64>) {
        let length = piece.end() - piece.start();
        let power = |k: usize| {
            let row = piece.power(k);
            let tilt = Vector3::new(row[3], row[4], row[5]);
            let mut linear = Vector3::new(row[0], row[1], row[2]) - tilt.cross(arm_mm);
            if k == 1 {
                linear -= slide;
            }
            [linear.x, linear.y, linear.z, tilt.x, tilt.y, tilt.z]
        };
        let (c1, c2, c3) = (power(1), power(2), power(3));
        for (lane, bound) in self.slopes.iter_mut().enumerate() {
            let (c1, c2, c3) = (c1[lane], c2[lane], c3[lane]);
            let slope = |t: f64| libm::fabs(c1 + t * (2.0 * c2 + t * 3.0 * c3));
            let turning = -c2 / (3.0 * c3);
            let inside = (0.0..=length).contains(&turning);
            let between = if inside { slope(turning) } else { 0.0 };
            *bound = bound.max(slope(0.0)).max(slope(length)).max(between);
        }
    }

    /// Raises the bounds of displacement and tilt to those of a piece: the sum of its absolute power terms at its end.
    fn take_sizes(&mut self, piece: &Piece) {
        let length = piece.end() - piece.start();
        let sizes: [f64; LANES] = core::array::from_fn(|lane| {
            let size = |k: usize| libm::fabs(piece.power(k)[lane]);
            size(0) + length * (size(1) + length * (size(2) + length * size(3)))
        });
        let [x, y, z, a, b, c] = sizes;
        self.linear_mm = self.linear_mm.max(Vector3::new(x, y, z).norm());
        self.angular_rad = self.angular_rad.max(Vector3::new(a, b, c).norm());
    }
}
