//! ASME B5.54: positioning accuracy, repeatability and reversal of a linear axis.

use crate::{Iso230Part2, StandardQuantity};

/// Quantities of ASME B5.54-2005. This edition evaluates like ISO 230-2:1997, under different names. The names are from
/// memory, and not verified against the text of the standard. The edition of 1992 is not supported.
pub fn asme_b5_54(result: &Iso230Part2) -> Vec<StandardQuantity> {
    [
        ("A", "bidirectional positioning accuracy", result.a),
        ("A_forward", "unidirectional positioning accuracy, forward", result.a_forward),
        ("A_backward", "unidirectional positioning accuracy, backward", result.a_backward),
        ("R", "bidirectional repeatability", result.r),
        ("R_forward", "unidirectional repeatability, forward", result.r_forward),
        ("R_backward", "unidirectional repeatability, backward", result.r_backward),
        ("E", "bidirectional systematic deviation", result.e),
        ("B", "largest reversal", result.b),
        ("mean_B", "mean reversal", result.mean_b),
    ]
    .map(|(symbol, name, value)| StandardQuantity::new(symbol, name, value))
    .to_vec()
}
