//! The macro that declares a table of a scene file; highway and gridworlds share it.

/// Declares a table of a scene file: a struct whose fields have defaults, and a check of each against its range.
macro_rules! table {
    ($(#[$attribute:meta])* pub struct $name:ident($key:literal) {
        $($(#[$field_attribute:meta])* $field:ident: $type:ty = $default:expr, $low:expr, $high:expr;)*
    }) => {
        $(#[$attribute])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name {
            $($(#[$field_attribute])* pub $field: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $name {
            pub(crate) fn check(
                &self,
                check: &crate::highway::file::Check<'_>,
            ) -> Result<(), crate::highway::FileError> {
                $(check.range(concat!($key, ".", stringify!($field)), f64::from(self.$field), f64::from($low), f64::from($high))?;)*
                Ok(())
            }
        }
    };
}
