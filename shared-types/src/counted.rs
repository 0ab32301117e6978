use std::fmt::Display;

/// A number with its noun in the singular or plural: `1 obstacle`, `2 obstacles`, `0 deadline misses`.
pub fn counted<N: Copy + Display + PartialEq + From<u8>>(count: N, noun: &str) -> String {
    let ending = match noun {
        _ if count == N::from(1) => "",
        _ if noun.ends_with("ss") => "es",
        _ => "s",
    };
    format!("{count} {noun}{ending}")
}

#[cfg(test)]
mod tests {
    use super::counted;

    #[test]
    fn one_is_singular_and_none_is_plural() {
        let texts = [0_u32, 1, 2].map(|count| counted(count, "obstacle"));
        assert_eq!(texts, ["0 obstacles", "1 obstacle", "2 obstacles"]);
        assert_eq!(counted(2_u64, "deadline miss"), "2 deadline misses");
    }
}
