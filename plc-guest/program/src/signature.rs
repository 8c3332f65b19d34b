//! Signatures: Ed25519 (RFC 8032) over the image's hash.
//!
//! What is signed is [`CONTEXT`] and the hash, so that a signature of an image can never be taken for one of
//! something else that has 32 bytes.

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};

use crate::Image;
use crate::error::ImageError;
use crate::layout::header;

/// What precedes the hash in the signed message.
pub const CONTEXT: &[u8; 22] = b"takt program image v1\0";

/// The public key of a private key.
#[must_use]
pub fn public(private: &[u8; 32]) -> [u8; 32] {
    SigningKey::from_bytes(private).verifying_key().to_bytes()
}

/// Signs an image with this private key. A signature that it has already is replaced.
///
/// # Errors
/// The image is not whole: only what [`Image::verify`] accepts, apart from an old signature, is signed.
pub fn sign(file: &mut [u8], private: &[u8; 32]) -> Result<(), ImageError> {
    if let Some(old) = file.get_mut(header::KEY.start..header::SIGNATURE.end) {
        old.fill(0);
    }
    let hash = Image::verify(file)?.hash();
    let key = SigningKey::from_bytes(private);
    let signature = key.sign(&message(hash)).to_bytes();
    file[header::KEY].copy_from_slice(key.verifying_key().as_bytes());
    file[header::SIGNATURE].copy_from_slice(&signature);
    Ok(())
}

/// Whether the image has no signature, or one that is its key's.
pub(crate) fn is_good(image: &Image<'_>) -> bool {
    let Some(key) = image.key() else { return true };
    let signature = Signature::from_bytes(&image.array(header::SIGNATURE));
    // Strict: refuses weak keys and signatures that others would accept and others not.
    VerifyingKey::from_bytes(&key)
        .is_ok_and(|key| key.verify_strict(&message(image.hash()), &signature).is_ok())
}

fn message(hash: [u8; 32]) -> [u8; 54] {
    let mut message = [0; 54];
    message[..CONTEXT.len()].copy_from_slice(CONTEXT);
    message[CONTEXT.len()..].copy_from_slice(&hash);
    message
}
