//! Passwords: taken, hashed with Argon2id, compared.

use std::{fmt, sync::LazyLock};

use argon2::{Argon2, PasswordHasher, PasswordVerifier};

/// The shortest password, characters.
const SHORTEST: usize = 12;
/// The longest password, bytes: a longer one only costs time.
const LONGEST: usize = 1024;

/// A password as somebody has entered it. It is never shown, not even to a debugger's log.
#[derive(Clone, PartialEq, Eq)]
pub struct Password(String);

/// Why a password is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PasswordError {
    /// It is too short.
    #[error("the password has {found} characters, expected at least {SHORTEST}")]
    Short {
        /// How many characters it has.
        found: usize,
    },
    /// It is too long.
    #[error("the password has {found} bytes, expected at most {LONGEST}")]
    Long {
        /// How many bytes it has.
        found: usize,
    },
    #[error("the password could not be hashed")]
    Hash,
}

impl Password {
    /// Takes a password that somebody chooses.
    ///
    /// # Errors
    /// It is too short or too long.
    pub fn chosen(text: String) -> Result<Self, PasswordError> {
        let found = text.chars().count();
        if found < SHORTEST {
            return Err(PasswordError::Short { found });
        }
        Self::entered(text)
    }

    /// Takes a password with which somebody logs in.
    ///
    /// # Errors
    /// It is too long.
    pub fn entered(text: String) -> Result<Self, PasswordError> {
        if text.len() > LONGEST {
            return Err(PasswordError::Long { found: text.len() });
        }
        Ok(Self(text))
    }
}

impl fmt::Debug for Password {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Password(..)")
    }
}

/// The hash of a password with a salt drawn for it, in the form `$argon2id$v=19$…` (19 MiB, two passes).
///
/// # Errors
/// The hash cannot be made: no memory, no random numbers.
pub fn hash(password: &Password) -> Result<String, PasswordError> {
    let hash = Argon2::default().hash_password(password.0.as_bytes());
    hash.map(|hash| hash.to_string())
        .map_err(|_| PasswordError::Hash)
}

/// Whether a password has this hash. Without a hash, of a user that is not there, it takes as long, and is `false`.
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
        assert_eq!(
            Password::chosen("äääääääääää".to_owned()),
            Err(PasswordError::Short { found: 11 })
        );
        assert!(Password::chosen("ä".repeat(12)).is_ok());
        assert_eq!(
            Password::entered("a".repeat(1025)),
            Err(PasswordError::Long { found: 1025 })
        );
    }
}
