//! From readings to error curves: polynomial, Chebyshev, moving least squares, smoothing B-spline.
