//! Elementary functions: polynomials in f32 and f64 with bit-identical results on every processor.
//!
//! Functions of single numbers have no branches, so that compilers vectorise loops over slices. They return
//! NaN for the NaNs that arithmetic produces.

use pulp::Simd;

/// 1.5 * 2^23. Adding it to a number of moderate size rounds the number to an integer and leaves the integer
/// in the low bits.
const ROUND_F32: f32 = 12_582_912.0;
/// The same constant for f64: 1.5 * 2^52.
const ROUND_F64: f64 = 6_755_399_441_055_744.0;

/// e^x in f32 within 2 units in the last place; x is clamped to [-87, 88].
///
/// **Source**: Cody and Waite's reduction by multiples of ln 2, then the polynomial of `expf` in
/// the Cephes library (Moshier).
#[inline(always)]
pub fn exp_f32(x: f32) -> f32 {
    let x = if x < -87.0 { -87.0 } else { x };
    let x = if x > 88.0 { 88.0 } else { x };
    let shifted = x.mul_add(std::f32::consts::LOG2_E, ROUND_F32);
    let power = shifted - ROUND_F32;
    let r = power.mul_add(-0.693_359_4, x);
    let r = power.mul_add(2.121_944_4e-4, r);
    let p = 1.987_569_1e-4_f32
        .mul_add(r, 1.398_199_9e-3)
        .mul_add(r, 8.333_452e-3)
        .mul_add(r, 4.166_579_6e-2)
        .mul_add(r, 1.666_666_5e-1)
        .mul_add(r, 0.5);
    let p = p.mul_add(r * r, r) + 1.0;
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// sqrt(x) + y in f32 within 2 units in the last place, for x that are 0, a normal positive number or
/// infinity, and y >= 0.
///
/// **Source**: a first guess of 1 / sqrt(x) from its bits, with an error of at most 3.5 % (Muller et al.,
/// "Handbook of floating-point arithmetic", 2018, section 4.7.3). With r = 1 - x guess^2, sqrt(x) = x guess
/// (1 - r)^(-1/2). The last factor is the minimax polynomial of degree 4 for such r, with a relative error of
/// 2.4e-8.
#[inline(always)]
pub fn root_plus<S: Simd>(simd: S, x: S::f32s, y: S::f32s) -> S::f32s {
    let one = simd.splat_f32s(1.0);
    let half = simd.wrapping_dyn_shr_u32s(simd.transmute_u32s_f32s(x), simd.splat_u32s(1));
    let guess = simd.transmute_f32s_u32s(simd.sub_u32s(simd.splat_u32s(0x5F37_59DF), half));
    let root = simd.mul_f32s(x, guess);
    let r = simd.negate_mul_add_f32s(root, guess, one);
    let mut p = simd.splat_f32s(0.274_077_7);
    for coefficient in [0.313_944_7, 0.375_000_57, 0.499_998_3, 1.0] {
        p = simd.mul_add_f32s(p, r, simd.splat_f32s(coefficient));
    }
    simd.mul_add_f32s(root, p, y)
}

/// A number whose low bits are the whole number nearest to x, for x from -0.5 to 2^50; ties go to even numbers. Adding
/// whole numbers to it adds them to the low bits.
#[inline(always)]
pub fn nearest(x: f64) -> f64 {
    x + ROUND_F64
}

/// The low bits of a number from [`nearest`], which are less than 2^16.
#[inline(always)]
pub fn low_bits(x: f64) -> usize {
    usize::from(x.to_bits() as u16)
}

/// The square root in f64 within 2 units in the last place, for 0 or a finite normal positive number.
///
/// **Source**: a first guess as in [`root_plus`], then Goldschmidt's iteration for both the root and its
/// inverse, which doubles the number of correct digits per iteration (Muller et al., ibid.).
#[inline(always)]
pub fn root(x: f64) -> f64 {
    let guess = f64::from_bits(0x5FE6_EB50_C7B5_37A9u64.wrapping_sub(x.to_bits() >> 1));
    let (mut root, mut half_inverse) = (x * guess, 0.5 * guess);
    for _ in 0..3 {
        let rest = (-root).mul_add(half_inverse, 0.5);
        root = root.mul_add(rest, root);
        half_inverse = half_inverse.mul_add(rest, half_inverse);
    }
    let rest = (-root).mul_add(root, x);
    rest.mul_add(half_inverse, root)
}

/// e^x in f64 within 2 units in the last place; x is clamped to [-708, 709].
///
/// **Source**: reduction as in [`exp_f32`], then the series of e^r to order 13; on |r| <= ln 2 / 2, its
/// truncation error is 4e-18 of the result.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    let x = if x < -708.0 { -708.0 } else { x };
    let x = if x > 709.0 { 709.0 } else { x };
    let shifted = x.mul_add(std::f64::consts::LOG2_E, ROUND_F64);
    let power = shifted - ROUND_F64;
    let r = power.mul_add(-6.931_471_803_691_238e-1, x);
    let r = power.mul_add(-1.908_214_929_270_587_7e-10, r);
    // 1/n! from n = 13 down to 2, with odd and even n in separate chains: two short chains are faster than
    // one.
    let z = r * r;
    let odd = (1.0 / 6_227_020_800.0_f64)
        .mul_add(z, 1.0 / 39_916_800.0)
        .mul_add(z, 1.0 / 362_880.0)
        .mul_add(z, 1.0 / 5_040.0)
        .mul_add(z, 1.0 / 120.0)
        .mul_add(z, 1.0 / 6.0);
    let even = (1.0 / 479_001_600.0_f64)
        .mul_add(z, 1.0 / 3_628_800.0)
        .mul_add(z, 1.0 / 40_320.0)
        .mul_add(z, 1.0 / 720.0)
        .mul_add(z, 1.0 / 24.0)
        .mul_add(z, 0.5);
    let p = odd.mul_add(r, even).mul_add(z, r) + 1.0;
    f64::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 52))
}

/// ln x in f64 for a normal positive x, within 4 units in the last place.
///
/// With x = 2^k m, m in [sqrt(1/2), sqrt(2)), and s = (m - 1) / (m + 1), ln x = k ln 2 + 2 (s + s^3 / 3 + s^5
/// / 5 + …). The series is taken to s^21, with a truncation error of 2e-19.
#[inline(always)]
pub fn ln(x: f64) -> f64 {
    // The bits of sqrt(1/2), at which the reduction switches to the next power of two.
    const HALF_ROOT: u64 = 0x3FE6_A09E_667F_3BCD;
    let above = x.to_bits().wrapping_sub(HALF_ROOT);
    let m = f64::from_bits((above & 0x000F_FFFF_FFFF_FFFF).wrapping_add(HALF_ROOT));
    // The exponent as a float, by its bits: k is small enough for the mantissa of 1.5 * 2^52.
    let k =
        f64::from_bits(ROUND_F64.to_bits().wrapping_add(((above as i64) >> 52) as u64)) - ROUND_F64;
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let w = z * z;
    let odd = (1.0 / 21.0_f64)
        .mul_add(w, 1.0 / 17.0)
        .mul_add(w, 1.0 / 13.0)
        .mul_add(w, 1.0 / 9.0)
        .mul_add(w, 1.0 / 5.0);
    let even = (1.0 / 19.0_f64)
        .mul_add(w, 1.0 / 15.0)
        .mul_add(w, 1.0 / 11.0)
        .mul_add(w, 1.0 / 7.0)
        .mul_add(w, 1.0 / 3.0);
    let p = odd.mul_add(z, even);
    let series = 2.0 * (s * z).mul_add(p, s);
    // 0, or NaN if x is NaN.
    let nothing = x * 0.0;
    k.mul_add(std::f64::consts::LN_2, series) + nothing
}

/// cos(2 pi x) in f64 for |x| <= 1, within 1e-15.
///
/// With y = x - round(x) in [-1/2, 1/2] and u = 1/4 - |y|, cos(2 pi x) = sin(2 pi u). The series of the sine
/// is taken to order 21; for |2 pi u| <= pi / 2, its truncation error is 1e-18.
#[inline(always)]
pub fn cos_turns(x: f64) -> f64 {
    let y = x - ((x + ROUND_F64) - ROUND_F64);
    let a = std::f64::consts::TAU * (0.25 - y.abs());
    let z = -(a * a);
    // 1/n! for n = 21, 19, … 3; the signs come with z.
    let w = z * z;
    let odd = (1.0 / 51_090_942_171_709_440_000.0_f64)
        .mul_add(w, 1.0 / 355_687_428_096_000.0)
        .mul_add(w, 1.0 / 6_227_020_800.0)
        .mul_add(w, 1.0 / 362_880.0)
        .mul_add(w, 1.0 / 120.0);
    let even = (1.0 / 121_645_100_408_832_000.0_f64)
        .mul_add(w, 1.0 / 1_307_674_368_000.0)
        .mul_add(w, 1.0 / 39_916_800.0)
        .mul_add(w, 1.0 / 5_040.0)
        .mul_add(w, 1.0 / 6.0);
    let p = odd.mul_add(z, even);
    (a * z).mul_add(p, a)
}

/// tanh x in f32, within 5e-7.
///
/// **Source**: the rational function of odd order 13 over even order 6 that the Eigen library uses
/// (`generic_fast_tanh_float`), on |x| <= 7.9. Beyond that, the result is the value at the bound.
#[inline(always)]
pub fn tanh(x: f32) -> f32 {
    const BOUND: f32 = 7.905_311;
    let x = if x < -BOUND { -BOUND } else { x };
    let x = if x > BOUND { BOUND } else { x };
    let z = x * x;
    let above = (-2.760_768_5e-16_f32)
        .mul_add(z, 2.000_188e-13)
        .mul_add(z, -8.604_672e-11)
        .mul_add(z, 5.122_297_3e-8)
        .mul_add(z, 1.485_722_4e-5)
        .mul_add(z, 6.372_619_3e-4)
        .mul_add(z, 4.893_525e-3);
    let below = 1.198_258_4e-6_f32
        .mul_add(z, 1.185_347_1e-4)
        .mul_add(z, 2.268_434_6e-3)
        .mul_add(z, 4.893_525e-3);
    x * above / below
}

#[cfg(test)]
mod tests {
    use pulp::{Scalar, WithSimd};

    use super::*;
    use crate::kernel::Isa;

    /// How many numbers of a range are tested. Miri looks for undefined behaviour, for which a few suffice.
    const COUNT: u32 = if cfg!(miri) { 300 } else { 200_000 };

    /// Evenly spaced numbers from `low` to `high`, at an irregular offset.
    fn numbers(low: f64, high: f64) -> impl Iterator<Item = f64> {
        (0..COUNT).map(move |i| low + (high - low) * (f64::from(i) + 0.37) / f64::from(COUNT))
    }

    fn assert_relative(ours: f64, theirs: f64, units: f64, x: f64) {
        assert!(
            (ours - theirs).abs() <= units * f64::EPSILON * theirs.abs(),
            "{x}: {ours} {theirs}"
        );
    }

    /// Runs an operation as compiled for an instruction set.
    fn on<R>(isa: Isa, operation: impl Fn() -> R) -> R {
        struct Once<F>(F);
        impl<R, F: Fn() -> R> WithSimd for Once<F> {
            type Output = R;

            #[inline(always)]
            fn with_simd<S: Simd>(self, _: S) -> R {
                (self.0)()
            }
        }
        isa.run(Once(operation))
    }

    #[test]
    fn multiplications_and_additions_round_once_everywhere() {
        // Divides because powers are slightly inaccurate under Miri.
        let single = |power: u32| 1.0 / (1u64 << power) as f32;
        let double = |power: u32| 1.0 / (1u64 << power) as f64;
        for isa in Isa::available() {
            // 1 + 2^-11 + 2^-24 minus 1 + 2^-11: with intermediate rounding, the result would be 0.
            let x = 1.0 + single(12);
            let left = on(isa, || std::hint::black_box(x).mul_add(x, -(1.0 + single(11))));
            assert_eq!(left.to_bits(), single(24).to_bits(), "{}", isa.name());
            let x = 1.0 + double(27);
            let left = on(isa, || std::hint::black_box(x).mul_add(x, -(1.0 + double(26))));
            assert_eq!(left.to_bits(), double(54).to_bits(), "{}", isa.name());
        }
    }

    #[test]
    fn slices_hold_what_single_numbers_do_on_every_instruction_set() {
        for isa in Isa::available() {
            for len in [1, 3, 16, 37, 1000] {
                let x = |i: usize| (i as f64 * 0.731).sin() * 40.0;
                let singles: Vec<f32> = (0..len).map(|i| x(i) as f32).collect();
                let many: Vec<f32> = on(isa, || singles.iter().map(|x| exp_f32(*x)).collect());
                for (x, y) in singles.into_iter().zip(many) {
                    assert_eq!(y.to_bits(), exp_f32(x).to_bits());
                }
            }
        }
    }

    #[test]
    fn exponentials_are_those_of_libm() {
        for x in numbers(-700.0, 700.0).chain(numbers(-1.0, 1.0)) {
            assert_relative(exp(x), libm::exp(x), 2.0, x);
        }
        for x in numbers(-87.0, 88.0).chain(numbers(-1.0, 1.0)) {
            let (ours, theirs) = (exp_f32(x as f32), libm::exp(f64::from(x as f32)));
            assert!((f64::from(ours) / theirs - 1.0).abs() < 2.4e-7, "{x}: {ours} {theirs}");
        }
        assert_eq!((exp(0.0), exp_f32(0.0)), (1.0, 1.0));
        assert!(exp(f64::NAN).is_nan() && exp_f32(f32::NAN).is_nan());
        assert!(exp(1e9).is_finite() && exp(-1e9) > 0.0);
    }

    #[test]
    fn roots_are_those_of_the_processor() {
        let root_f32 = |x| root_plus(Scalar::new(), x, 0.0);
        for exponent in -120..120 {
            for x in numbers(1.0, 4.0).step_by(97) {
                let x = x as f32 * 2f32.powi(exponent);
                let ours = f64::from(root_f32(x)) / f64::from(x).sqrt();
                assert!((ours - 1.0).abs() < 2.0 * f64::from(f32::EPSILON), "{x}: {ours}");
            }
        }
        let sum = f64::from(root_plus(Scalar::new(), 2.0, 3.0)) / (2f64.sqrt() + 3.0);
        assert!((sum - 1.0).abs() < f64::from(f32::EPSILON), "{sum}");
        for x in numbers(1.0, 4.0).chain(numbers(0.0, 100.0)) {
            assert_relative(root(x), x.sqrt(), 2.0, x);
        }
        assert_eq!((root_f32(0.0), root(0.0)), (0.0, 0.0));
        assert!(root_f32(f32::NAN).is_nan() && root_f32(f32::INFINITY) == f32::INFINITY);
    }

    #[test]
    fn logarithms_are_those_of_libm() {
        for x in numbers(0.0, 1.0).chain(numbers(0.9, 1.1)).chain(numbers(1.0, 1e9)) {
            assert_relative(ln(x), libm::log(x), 4.0, x);
        }
        assert_eq!(ln(1.0), 0.0);
        assert!(ln(f64::NAN).is_nan());
    }

    #[test]
    fn nearest_numbers_are_those_of_the_processor() {
        for x in numbers(-0.5, 9.0).chain([-0.5, 0.5, 1.5, 2.5, 65_534.0]) {
            let nearest = nearest(x);
            assert_eq!(low_bits(nearest), x.round_ties_even() as usize, "{x}");
            assert_eq!(low_bits(nearest + 1.0), x.round_ties_even() as usize + 1, "{x}");
        }
    }

    #[test]
    fn cosines_are_those_of_libm() {
        for x in numbers(-1.0, 1.0) {
            let theirs = libm::cos(std::f64::consts::TAU * x);
            assert!((cos_turns(x) - theirs).abs() < 1e-15, "{x}");
        }
    }

    #[test]
    fn hyperbolic_tangents_are_those_of_libm() {
        for x in numbers(-12.0, 12.0).chain(numbers(-0.1, 0.1)) {
            let theirs = libm::tanh(f64::from(x as f32));
            assert!((f64::from(tanh(x as f32)) - theirs).abs() < 5e-7, "{x}");
        }
        assert_eq!(tanh(0.0), 0.0);
        assert!(tanh(f32::NAN).is_nan());
    }
}
