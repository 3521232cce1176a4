//! Constants as they stand in a file of Rust, tests excluded.

use proc_macro2::Span;
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, Expr, File, Ident, ImplItem, Item, Lit, Meta, Type};

/// Defaults of these settings are constants as well: the struct has the comments, `fn default` the values.
const SETTINGS: &str = "MapperConfig";

/// A constant of the code.
#[derive(Debug)]
pub(super) struct Constant {
    /// Of its crate on the page.
    pub(super) title: &'static str,
    /// `detect::copies`.
    pub(super) module: String,
    pub(super) name: String,
    /// As the code has it, without white space.
    pub(super) value: String,
    comment: String,
}

impl Constant {
    /// The first sentence of its comment; nothing if it has none.
    pub(super) fn line(&self) -> &str {
        let end = self
            .comment
            .find(". ")
            .map_or(self.comment.len(), |at| at + 1);
        &self.comment[..end]
    }
}

/// Everything in the file that is a constant made of numbers, in its order.
pub(super) fn constants_of(title: &'static str, module: &str, file: &File) -> Vec<Constant> {
    let mut finder = Finder {
        title,
        module,
        found: Vec::new(),
    };
    finder.visit_file(file);
    let settings = defaults_in(file).into_iter();
    let settings = settings.map(|(name, value, comment)| Constant {
        title,
        module: module.to_owned(),
        name,
        value,
        comment,
    });
    finder.found.into_iter().chain(settings).collect()
}

/// What the paths of files begin with that the file at `path` brings in for tests alone.
pub(super) fn files_for_tests(path: &str, file: &File) -> Vec<String> {
    let folder = match path.rsplit_once('/') {
        Some((folder, "mod.rs" | "lib.rs" | "main.rs")) => folder,
        _ => path.trim_end_matches(".rs"),
    };
    let modules = file.items.iter().filter_map(|item| match item {
        Item::Mod(module) if module.content.is_none() && is_for_tests(&module.attrs) => {
            Some(&module.ident)
        }
        _ => None,
    });
    modules
        .flat_map(|name| [format!("{folder}/{name}.rs"), format!("{folder}/{name}/")])
        .collect()
}

struct Finder<'a> {
    title: &'static str,
    module: &'a str,
    found: Vec<Constant>,
}

impl Finder<'_> {
    fn take(&mut self, attributes: &[Attribute], name: &Ident, kind: &Type, value: &Expr) {
        if is_of_numbers(kind, value) {
            self.found.push(Constant {
                title: self.title,
                module: self.module.to_owned(),
                name: name.to_string(),
                value: text_of(value.span()),
                comment: comment_of(attributes),
            });
        }
    }
}

impl<'ast> Visit<'ast> for Finder<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        let attributes = match item {
            Item::Fn(item) => &item.attrs,
            Item::Impl(item) => &item.attrs,
            Item::Mod(item) => &item.attrs,
            Item::Const(item) => &item.attrs,
            _ => return visit::visit_item(self, item),
        };
        if !is_for_tests(attributes) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_const(&mut self, item: &'ast syn::ItemConst) {
        self.take(&item.attrs, &item.ident, &item.ty, &item.expr);
    }

    fn visit_impl_item_const(&mut self, item: &'ast syn::ImplItemConst) {
        self.take(&item.attrs, &item.ident, &item.ty, &item.expr);
    }

    fn visit_trait_item_const(&mut self, item: &'ast syn::TraitItemConst) {
        if let Some((_, value)) = &item.default {
            self.take(&item.attrs, &item.ident, &item.ty, value);
        }
    }
}

fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        let is_test = |ident: Ident| ident == "test";
        attribute.path().is_ident("cfg") && attribute.parse_args().is_ok_and(is_test)
    })
}

/// By its type, or by a number in its value; not what is worked out by a block, nor a value of its own type.
fn is_of_numbers(kind: &Type, value: &Expr) -> bool {
    const NUMBERS: [&str; 8] = ["f32", "f64", "u8", "u16", "u32", "u64", "i32", "usize"];
    if is_own(kind) || matches!(value, Expr::Block(_)) {
        return false;
    }
    let name = match kind {
        Type::Path(path) => path.path.get_ident(),
        _ => None,
    };
    let is_number = name.is_some_and(|name| NUMBERS.iter().any(|number| name == number));
    is_number || has_number(value)
}

/// Of the type that the constant belongs to: a value that has a name.
fn is_own(kind: &Type) -> bool {
    match kind {
        Type::Array(array) => is_own(&array.elem),
        Type::Path(path) => path.path.is_ident("Self"),
        _ => false,
    }
}

fn has_number(value: &Expr) -> bool {
    struct Numbers(bool);
    impl<'ast> Visit<'ast> for Numbers {
        fn visit_lit(&mut self, literal: &'ast Lit) {
            self.0 |= matches!(literal, Lit::Int(_) | Lit::Float(_));
        }
    }
    let mut numbers = Numbers(false);
    numbers.visit_expr(value);
    numbers.0
}

/// Name, value and comment of each setting whose default is a number.
fn defaults_in(file: &File) -> Vec<(String, String, String)> {
    let fields = file.items.iter().find_map(|item| match item {
        Item::Struct(item) if item.ident == SETTINGS => Some(&item.fields),
        _ => None,
    });
    let Some(fields) = fields else {
        return Vec::new();
    };
    let values = file.items.iter().find_map(default_of_settings);
    let values = values.into_iter().flat_map(|values| &values.fields);
    let figures =
        values.filter(|field| matches!(field.expr, Expr::Lit(_)) && has_number(&field.expr));
    let told = figures.filter_map(|figure| {
        let syn::Member::Named(name) = &figure.member else {
            return None;
        };
        let field = fields
            .iter()
            .find(|field| field.ident.as_ref() == Some(name))?;
        let value = text_of(figure.expr.span());
        Some((name.to_string(), value, comment_of(&field.attrs)))
    });
    told.collect()
}

/// The value that `fn default` gives for the settings.
fn default_of_settings(item: &Item) -> Option<&syn::ExprStruct> {
    let Item::Impl(item) = item else { return None };
    let is_settings = matches!(&*item.self_ty, Type::Path(path) if path.path.is_ident(SETTINGS));
    item.items.iter().filter(|_| is_settings).find_map(|item| {
        let ImplItem::Fn(function) = item else {
            return None;
        };
        match function.block.stmts.last() {
            Some(syn::Stmt::Expr(Expr::Struct(value), None)) if function.sig.ident == "default" => {
                Some(value)
            }
            _ => None,
        }
    })
}

/// Lines joined.
fn comment_of(attributes: &[Attribute]) -> String {
    let lines = attributes
        .iter()
        .filter_map(|attribute| match &attribute.meta {
            Meta::NameValue(pair) if pair.path.is_ident("doc") => match &pair.value {
                Expr::Lit(value) => match &value.lit {
                    Lit::Str(text) => Some(text.value().trim().to_owned()),
                    _ => None,
                },
                _ => None,
            },
            _ => None,
        });
    lines.collect::<Vec<_>>().join(" ")
}

/// The source there, without white space and without the comma that ends a list.
fn text_of(span: Span) -> String {
    let text: String = span.source_text().unwrap_or_default();
    let text = crate::code::without_comments_and_literals(&text);
    let text: String = text.split_whitespace().collect();
    text.replace(",]", "]")
        .replace(",)", ")")
        .replace(",}", "}")
}
