//! Tokens to an expression: `or` binds least, then `and`, `not`, comparisons.

use super::FilterError;
use super::lexer::{Kind, Token, tokens};
use crate::lattice::Decimal;

/// How deep parentheses and `not` may nest.
const MAX_DEPTH: usize = 200;

/// A relation between two values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Relation {
    Equal,
    NotEqual,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
}

impl Relation {
    fn from_symbol(symbol: &str) -> Option<Self> {
        Some(match symbol {
            "=" => Self::Equal,
            "<>" => Self::NotEqual,
            "<" => Self::Less,
            "<=" => Self::LessOrEqual,
            ">" => Self::Greater,
            ">=" => Self::GreaterOrEqual,
            _ => return None,
        })
    }

    /// The relation with its sides exchanged.
    fn mirrored(self) -> Self {
        match self {
            Self::Less => Self::Greater,
            Self::LessOrEqual => Self::GreaterOrEqual,
            Self::Greater => Self::Less,
            Self::GreaterOrEqual => Self::LessOrEqual,
            same => same,
        }
    }
}

/// What a name stands for, and where it was written.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Name {
    pub name: String,
    /// `raw(NAME)`: the stored value, not the scaled one.
    pub raw: bool,
    /// In quotes: never the keyword `scan`.
    pub quoted: bool,
    pub at: usize,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Literal {
    Number(Decimal),
    Text(String),
}

/// An expression over names that are not looked up yet.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Expression {
    And(Vec<Expression>),
    Or(Vec<Expression>),
    Not(Box<Expression>),
    /// `name relation literal`.
    Compare(Name, Relation, Literal, usize),
    /// `name relation name`.
    Pair(Name, Relation, Name),
    /// `name between low and high`.
    Between(Name, Decimal, Decimal),
    /// `name in (...)`, each with its place.
    In(Name, Vec<(Literal, usize)>),
    IsNull(Name),
}

enum Operand {
    Name(Name),
    Literal(Literal, usize),
}

pub(super) fn parse(text: &str) -> Result<Expression, FilterError> {
    let mut parser = Parser { text, tokens: tokens(text)?, next: 0, depth: 0 };
    if parser.peek() == &Kind::End {
        return Err(parser.error("the filter is empty"));
    }
    let expression = parser.or()?;
    match parser.peek() {
        Kind::End => Ok(expression),
        Kind::Symbol(")") => Err(parser.error("this parenthesis closes nothing")),
        _ => Err(parser.error("expected \"and\", \"or\" or the end")),
    }
}

struct Parser<'a> {
    text: &'a str,
    tokens: Vec<Token>,
    next: usize,
    depth: usize,
}

impl Parser<'_> {
    fn peek(&self) -> &Kind {
        &self.tokens[self.next].kind
    }

    fn at(&self) -> usize {
        self.tokens[self.next].at
    }

    fn error(&self, message: impl Into<String>) -> FilterError {
        FilterError::new(message, self.text, self.at())
    }

    /// Takes the token; the end is never passed.
    fn advance(&mut self) -> Kind {
        let kind = self.peek().clone();
        if kind != Kind::End {
            self.next += 1;
        }
        kind
    }

    fn keyword_is(&self, word: &str) -> bool {
        match self.peek() {
            Kind::Word(w) => w.eq_ignore_ascii_case(word),
            Kind::Symbol(s) => *s == word,
            _ => false,
        }
    }

    fn take(&mut self, word: &str) -> bool {
        let found = self.keyword_is(word);
        if found {
            self.next += 1;
        }
        found
    }

    fn expect(&mut self, word: &str) -> Result<(), FilterError> {
        if self.take(word) { Ok(()) } else { Err(self.error(format!("expected \"{word}\""))) }
    }

    fn or(&mut self) -> Result<Expression, FilterError> {
        let mut terms = vec![self.and()?];
        while self.take("or") {
            terms.push(self.and()?);
        }
        Ok(if terms.len() == 1 { terms.remove(0) } else { Expression::Or(terms) })
    }

    fn and(&mut self) -> Result<Expression, FilterError> {
        let mut terms = vec![self.not()?];
        while self.take("and") {
            terms.push(self.not()?);
        }
        Ok(if terms.len() == 1 { terms.remove(0) } else { Expression::And(terms) })
    }

    fn not(&mut self) -> Result<Expression, FilterError> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(self.error(format!("nested deeper than {MAX_DEPTH}")));
        }
        let expression = if self.take("not") {
            Expression::Not(Box::new(self.not()?))
        } else if self.take("(") {
            let inner = self.or()?;
            self.expect(")")?;
            inner
        } else {
            self.predicate()?
        };
        self.depth -= 1;
        Ok(expression)
    }

    fn predicate(&mut self) -> Result<Expression, FilterError> {
        let left = self.operand()?;
        if let Kind::Symbol(symbol) = *self.peek()
            && let Some(relation) = Relation::from_symbol(symbol)
        {
            let at = self.at();
            self.next += 1;
            let right = self.operand()?;
            if matches!(*self.peek(), Kind::Symbol(again) if Relation::from_symbol(again).is_some()) {
                return Err(self.error("comparisons cannot be chained; write \"between\" or join two by \"and\""));
            }
            return match (left, right) {
                (Operand::Name(a), Operand::Name(b)) => Ok(Expression::Pair(a, relation, b)),
                (Operand::Name(a), Operand::Literal(b, at)) => Ok(Expression::Compare(a, relation, b, at)),
                (Operand::Literal(a, at), Operand::Name(b)) => Ok(Expression::Compare(b, relation.mirrored(), a, at)),
                (Operand::Literal(..), Operand::Literal(..)) => {
                    Err(FilterError::new("this compares two constants; name an attribute", self.text, at))
                }
            };
        }
        let name = match left {
            Operand::Name(name) => name,
            Operand::Literal(_, at) => {
                return Err(FilterError::new("expected an attribute's name here", self.text, at));
            }
        };
        if self.take("is") {
            let negated = self.take("not");
            self.expect("null")?;
            return Ok(negate_if(negated, Expression::IsNull(name)));
        }
        let negated = self.take("not");
        if self.take("between") {
            let low = self.number()?;
            self.expect("and")?;
            let high = self.number()?;
            return Ok(negate_if(negated, Expression::Between(name, low, high)));
        }
        if self.take("in") {
            self.expect("(")?;
            let mut values = Vec::new();
            loop {
                let at = self.at();
                match self.operand()? {
                    Operand::Literal(literal, at) => values.push((literal, at)),
                    // `scan in ("a", "b")`
                    Operand::Name(Name { name, quoted: true, .. }) => values.push((Literal::Text(name), at)),
                    Operand::Name(_) => {
                        return Err(FilterError::new("expected a number or a text in quotes", self.text, at));
                    }
                }
                if !self.take(",") {
                    break;
                }
            }
            self.expect(")")?;
            return Ok(negate_if(negated, Expression::In(name, values)));
        }
        Err(self.error("expected a comparison: =, <>, <, <=, >, >=, \"between\", \"in\" or \"is null\""))
    }

    fn number(&mut self) -> Result<Decimal, FilterError> {
        match self.operand()? {
            Operand::Literal(Literal::Number(number), _) => Ok(number),
            Operand::Literal(_, at) | Operand::Name(Name { at, .. }) => {
                Err(FilterError::new("expected a number", self.text, at))
            }
        }
    }

    fn operand(&mut self) -> Result<Operand, FilterError> {
        let at = self.at();
        match self.advance() {
            Kind::Number(number) => Ok(Operand::Literal(Literal::Number(number), at)),
            Kind::Text(text) => Ok(Operand::Literal(Literal::Text(text), at)),
            Kind::Quoted(name) => Ok(Operand::Name(Name { name, raw: false, quoted: true, at })),
            Kind::Symbol(sign @ ("-" | "+")) => match self.advance() {
                Kind::Number(number) if sign == "-" => {
                    let negative = Decimal::new(-number.mantissa(), number.exponent());
                    Ok(Operand::Literal(Literal::Number(negative), at))
                }
                Kind::Number(number) => Ok(Operand::Literal(Literal::Number(number), at)),
                _ => Err(FilterError::new("expected a number after this sign", self.text, at)),
            },
            Kind::Word(word) if is_reserved(&word) => {
                let hint = if word.eq_ignore_ascii_case("null") { "; compare with null by \"is null\"" } else { "" };
                Err(FilterError::new(format!("expected an attribute or a number{hint}"), self.text, at))
            }
            Kind::Word(word) => {
                if word.eq_ignore_ascii_case("raw") && self.take("(") {
                    let at = self.at();
                    let (name, quoted) = match self.advance() {
                        Kind::Word(name) => (name, false),
                        Kind::Quoted(name) => (name, true),
                        _ => return Err(FilterError::new("expected an attribute's name here", self.text, at)),
                    };
                    self.expect(")")?;
                    return Ok(Operand::Name(Name { name, raw: true, quoted, at }));
                }
                Ok(Operand::Name(Name { name: word, raw: false, quoted: false, at }))
            }
            Kind::Symbol(_) | Kind::End => Err(FilterError::new("expected an attribute or a number", self.text, at)),
        }
    }
}

fn negate_if(negated: bool, expression: Expression) -> Expression {
    if negated { Expression::Not(Box::new(expression)) } else { expression }
}

fn is_reserved(word: &str) -> bool {
    ["and", "or", "not", "in", "between", "is", "null"].iter().any(|k| word.eq_ignore_ascii_case(k))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(expression: &Expression) -> String {
        let join = |terms: &[Expression], word: &str| {
            format!("({})", terms.iter().map(shape).collect::<Vec<_>>().join(&format!(" {word} ")))
        };
        match expression {
            Expression::And(terms) => join(terms, "and"),
            Expression::Or(terms) => join(terms, "or"),
            Expression::Not(inner) => format!("not {}", shape(inner)),
            Expression::Compare(name, ..)
            | Expression::Between(name, ..)
            | Expression::In(name, _)
            | Expression::IsNull(name) => name.name.clone(),
            Expression::Pair(a, _, b) => format!("{}~{}", a.name, b.name),
        }
    }

    #[test]
    fn words_and_symbols_bind_as_in_sql() {
        let shape_of = |text: &str| shape(&parse(text).unwrap());
        assert_eq!(shape_of("a=1 or b=1 and not c=1 or d=1"), "(a or (b and not c) or d)");
        assert_eq!(shape_of("a==1 && (b<>1 || !c != 2)"), "(a and (b or not c))");
        assert_eq!(shape_of("a between 1 and 2 and b in (1,-2.5)"), "(a and b)");
        assert_eq!(shape_of("NOT a NOT IN (1) AND b IS NOT NULL"), "(not not a and not b)");
        assert_eq!(shape_of("5 > \"my name\" or scan = 'x'"), "(my name or scan)");
        assert_eq!(shape_of("ReturnNumber = NumberOfReturns"), "ReturnNumber~NumberOfReturns");
        let mirrored = parse("5 < a").unwrap();
        assert!(matches!(mirrored, Expression::Compare(_, Relation::Greater, _, _)));
        assert!(matches!(parse("raw(x) = 1").unwrap(), Expression::Compare(Name { raw: true, .. }, ..)));
    }

    #[test]
    fn errors_point_at_the_character() {
        let cases = [
            ("", 0),
            ("Intensity", 9),
            ("Intensity >", 11),
            ("a = 1 b = 2", 6),
            ("(a = 1", 6),
            ("a = 1)", 5),
            ("a = 1 and", 9),
            ("1 < a < 3", 6),
            ("a between 1 or 2", 12),
            ("a in 1", 5),
            ("a in (1, b)", 9),
            ("a is 5", 5),
            ("1 = 1", 2),
            ("a = null", 4),
            ("a = - b", 4),
            ("a ? 1", 2),
            ("5", 0),
        ];
        for (text, at) in cases {
            let error = parse(text).expect_err(text);
            assert_eq!(error.at(), at, "{text}: {error}");
        }
        let deep = format!("{}a = 1{}", "(".repeat(5000), ")".repeat(5000));
        assert!(parse(&deep).is_err());
    }
}
