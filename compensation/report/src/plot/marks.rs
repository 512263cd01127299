//! Point markers, which distinguish directions without colour.

use super::svg::finite;

/// The marker at each point of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    None,
    /// A filled dot.
    Dot,
    /// A triangle that points up: forward.
    Up,
    /// A triangle that points down: backward.
    Down,
    /// A diagonal cross.
    Cross,
}

pub(crate) fn outline(path: &mut String, mark: Mark, [x, y]: [f64; 2], size: f64) {
    use std::fmt::Write as _;
    if !(x.is_finite() && y.is_finite()) {
        return;
    }
    let r = finite(size);
    let f = finite;
    let _ = match mark {
        Mark::None => Ok(()),
        Mark::Dot => write!(
            path,
            "M{} {}a{r} {r} 0 1 0 {} 0a{r} {r} 0 1 0 {} 0",
            f(x - r),
            f(y),
            2.0 * r,
            -2.0 * r
        ),
        Mark::Up => write!(
            path,
            "M{} {}l{} {}h{}z",
            f(x),
            f(y - 1.15 * r),
            f(1.1 * r),
            f(1.9 * r),
            f(-2.2 * r)
        ),
        Mark::Down => write!(
            path,
            "M{} {}l{} {}h{}z",
            f(x),
            f(y + 1.15 * r),
            f(1.1 * r),
            f(-1.9 * r),
            f(-2.2 * r)
        ),
        Mark::Cross => write!(
            path,
            "M{} {}l{} {}m{} 0l{} {}",
            f(x - r),
            f(y - r),
            2.0 * r,
            2.0 * r,
            -2.0 * r,
            2.0 * r,
            -2.0 * r
        ),
    };
}
