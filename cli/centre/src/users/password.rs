//! Passwords: validation, hashing with Argon2id, verification.

use std::{fmt, sync::LazyLock};

use crate::Error;
use argon2::{Argon2, PasswordHasher, PasswordVerifier};

/// Minimum length of a password, characters.
const MIN_CHARACTERS: usize = 12;
/// Maximum length of a password, bytes: a longer one only costs time.
const MAX_BYTES: usize = 1024;

/// A password as entered. It is never displayed, not even by `Debug`.
#[derive(Clone, PartialEq, Eq)]
pub struct Password(String);

impl Password {
    /// Validates a newly chosen password.
    pub fn chosen(text: String) -> Result<Self, Error> {
        let found = text.chars().count();
        if found < MIN_CHARACTERS {
            return Err(Error::Wrong(format!(
                "the password has {found} characters, expected at least {MIN_CHARACTERS}"
            )));
        }
        Self::entered(text)
    }

    /// Wraps a password entered at login.
    pub fn entered(text: String) -> Result<Self, Error> {
        if text.len() > MAX_BYTES {
            return Err(Error::Wrong(format!(
                "the password has {} bytes, expected at most {MAX_BYTES}",
                text.len()
            )));
        }
        Ok(Self(text))
    }
}

impl fmt::Debug for Password {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Password(..)")
    }
}

/// Hashes a password with a random salt, in the form `$argon2id$v=19$…` (19 MiB, two passes).
pub fn hash(password: &Password) -> Result<String, Error> {
    let hash = Argon2::default().hash_password(password.0.as_bytes());
    hash.map(|hash| hash.to_string())
        .map_err(|_| Error::Wrong("the password could not be hashed".to_owned()))
}

/// Verifies a password. Without a stored hash (unknown user) it takes the same time and returns `false`.
pub fn is_right(password: &Password, stored: Option<&str>) -> bool {
    static NOBODY: LazyLock<Option<String>> =
        LazyLock::new(|| hash(&Password("of nobody at all".to_owned())).ok());
    let Some(compared) = stored.or(NOBODY.as_deref()) else {
        return false;
    };
    let argon2 = Argon2::default();
    let equal = argon2.verify_password(password.0.as_bytes(), compared);
    equal.is_ok() && stored.is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_password_is_right() {
        let of = |text: &str| Password::entered(text.to_owned()).unwrap();
        let stored = hash(&of("correct horse battery")).unwrap();
        assert!(
            stored.starts_with("$argon2id$v=19$m=19456,t=2,p=1$"),
            "{stored}"
        );
        assert!(is_right(&of("correct horse battery"), Some(&stored)));
        assert!(!is_right(&of("correct horse batterz"), Some(&stored)));
        assert!(!is_right(&of(""), Some(&stored)));
        assert!(!is_right(&of("of nobody at all"), None));
        assert!(!is_right(&of("x"), Some("no hash")));
        // Another salt each time.
        assert_ne!(stored, hash(&of("correct horse battery")).unwrap());
        assert_eq!(format!("{:?}", of("secret")), "Password(..)");
    }

    #[test]
    fn short_and_long_ones_are_refused() {
        let refused = |made: Result<Password, Error>| made.unwrap_err().to_string();
        let short = refused(Password::chosen("ä".repeat(11)));
        assert_eq!(
            short,
            "the password has 11 characters, expected at least 12"
        );
        assert!(Password::chosen("ä".repeat(12)).is_ok());
        let long = refused(Password::entered("a".repeat(1025)));
        assert_eq!(long, "the password has 1025 bytes, expected at most 1024");
    }
}
