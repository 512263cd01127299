//! Error curves over an axis coordinate: value, derivative and range, without allocation in evaluation.
