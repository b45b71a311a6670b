//! Elementary functions with the same results on every processor, from the compiler's own library.
//!
//! The machine's C library is not used because its results depend on the processor. Sine, cosine, tangent, exponential
//! and logarithm come from the compiler's runtime, which the build links into the same object.

const math = @import("std").math;

export fn atan(x: f64) f64 {
    return math.atan(x);
}

export fn atan2(y: f64, x: f64) f64 {
    return math.atan2(y, x);
}

export fn asin(x: f64) f64 {
    return math.asin(x);
}

export fn acos(x: f64) f64 {
    return math.acos(x);
}

export fn cbrt(x: f64) f64 {
    return math.cbrt(x);
}

export fn hypot(x: f64, y: f64) f64 {
    return math.hypot(x, y);
}

export fn tanh(x: f64) f64 {
    return math.tanh(x);
}

export fn pow(x: f64, y: f64) f64 {
    return math.pow(f64, x, y);
}
