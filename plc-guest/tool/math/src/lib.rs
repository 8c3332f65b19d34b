//! The functions of `math.h` that are no single instruction, for control programs in C: those of the crate `libm`, which
//! Structured Text has, too. So both languages compute the same.
#![no_std]

macro_rules! functions {
    ($($name:ident($($x:ident: $ty:ty),*) -> $result:ty;)*) => { $(
        #[doc = concat!("`", stringify!($name), "` of `math.h`.")]
        // SAFETY: it is the function of that name, with the types that C has for it.
        #[unsafe(no_mangle)]
        pub extern "C" fn $name($($x: $ty),*) -> $result {
            libm::$name($($x),*)
        }
    )* };
}

macro_rules! of_one {
    ($($name:ident $short:ident)*) => { functions! { $(
        $name(x: f64) -> f64;
        $short(x: f32) -> f32;
    )* } };
}

macro_rules! of_two {
    ($($name:ident $short:ident)*) => { functions! { $(
        $name(x: f64, y: f64) -> f64;
        $short(x: f32, y: f32) -> f32;
    )* } };
}

of_one! {
    sin sinf cos cosf tan tanf asin asinf acos acosf atan atanf sinh sinhf cosh coshf tanh tanhf
    asinh asinhf acosh acoshf atanh atanhf
    exp expf exp2 exp2f expm1 expm1f log logf log2 log2f log10 log10f log1p log1pf cbrt cbrtf
    rint rintf
}

of_two! { atan2 atan2f pow powf hypot hypotf fdim fdimf remainder remainderf }

functions! {
    ldexp(x: f64, n: i32) -> f64;
    ldexpf(x: f32, n: i32) -> f32;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
