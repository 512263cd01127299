//! Measurement files and ISO 230 evaluation: positioning, straightness, squareness, Abbe.
