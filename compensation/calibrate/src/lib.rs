//! From a calibration file to a machine file, and its inverse, the virtual shop.
