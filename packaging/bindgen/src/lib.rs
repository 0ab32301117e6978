//! Empty: nothing calls bindgen in a build for Linux (`docs/decisions/0011-build.md`).
