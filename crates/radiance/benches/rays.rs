//! Time of a training batch of the hash-grid field at its full size: 4096 rays.
fn main() {
    divan::main();
}
