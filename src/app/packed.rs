//! Values as compact bytes: documents of a case that hold more numbers than anybody would read as text.
//!
//! A line that names the document and its version, the length of what follows, the value, and its BLAKE3 hash. Numbers
//! are little-endian and of fixed width, so that an `f64` keeps every bit; lists and texts begin with their length,
//! fields and variants with their names, so that a file of another version is noticed instead of misread.
//!
//! Nothing is believed before it was compared with the bytes that are there: a damaged length cannot ask for memory.
//!
//! What it does not do: values that describe themselves (untagged or flattened types of serde) cannot be read back.

use serde::de::{self, DeserializeOwned, DeserializeSeed, IntoDeserializer, Visitor};
use serde::ser::{self, Serialize};

const HASH_BYTES: usize = blake3::OUT_LEN;
const LENGTH_BYTES: usize = size_of::<u64>();

/// The bytes are not the document that was expected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PackedError {
    /// The file does not begin as it should.
    #[error("not a {expected} of this version of lumenfab")]
    Foreign {
        /// The document and its version.
        expected: &'static str,
    },
    /// There is more or less than the header says.
    #[error("found {found} bytes, expected {expected}: the file is damaged")]
    Length {
        /// Bytes behind the header.
        found: usize,
        /// What the header promises.
        expected: u64,
    },
    /// The hash is another one.
    #[error("its checksum does not fit its contents: the file is damaged")]
    Checksum,
    /// The value is none of this type.
    #[error("{0}: the file was written by another version of lumenfab")]
    Value(String),
}

impl ser::Error for PackedError {
    fn custom<T: std::fmt::Display>(message: T) -> Self {
        Self::Value(message.to_string())
    }
}

impl de::Error for PackedError {
    fn custom<T: std::fmt::Display>(message: T) -> Self {
        Self::Value(message.to_string())
    }
}

/// The document's bytes; `name` is its first line, with its version: `solid 1`.
///
/// # Errors
/// [`PackedError::Value`] where the value holds a list of unknown length.
pub fn to_bytes(name: &str, value: &impl Serialize) -> Result<Vec<u8>, PackedError> {
    let mut bytes = heading(name);
    let start = bytes.len();
    bytes.extend([0; LENGTH_BYTES]);
    let mut packer = Packer { bytes };
    value.serialize(&mut packer)?;
    let mut bytes = packer.bytes;
    let payload = start + LENGTH_BYTES;
    let length = (bytes.len() - payload) as u64;
    bytes[start..payload].copy_from_slice(&length.to_le_bytes());
    let hash = blake3::hash(&bytes[payload..]);
    bytes.extend_from_slice(hash.as_bytes());
    Ok(bytes)
}

/// Reads a document.
///
/// # Errors
/// [`PackedError`] where the bytes are not what [`to_bytes`] makes of such a value.
pub fn from_bytes<T: DeserializeOwned>(name: &'static str, bytes: &[u8]) -> Result<T, PackedError> {
    let rest = bytes.strip_prefix(&heading(name)[..]).ok_or(PackedError::Foreign { expected: name })?;
    let short = PackedError::Length { found: rest.len(), expected: (LENGTH_BYTES + HASH_BYTES) as u64 };
    let (length, rest) = rest.split_first_chunk::<LENGTH_BYTES>().ok_or(short.clone())?;
    let (payload, hash) = rest.split_last_chunk::<HASH_BYTES>().ok_or(short)?;
    let expected = u64::from_le_bytes(*length);
    if payload.len() as u64 != expected {
        return Err(PackedError::Length { found: payload.len(), expected });
    }
    if blake3::hash(payload).as_bytes() != hash {
        return Err(PackedError::Checksum);
    }
    let mut unpacker = Unpacker { rest: payload };
    let value = T::deserialize(&mut unpacker)?;
    if unpacker.rest.is_empty() { Ok(value) } else { Err(PackedError::Value("something follows it".into())) }
}

fn heading(name: &str) -> Vec<u8> {
    format!("lumenfab {name}\n").into_bytes()
}

struct Packer {
    bytes: Vec<u8>,
}

impl Packer {
    fn length(&mut self, n: usize) {
        self.bytes.extend((n as u64).to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.length(text.len());
        self.bytes.extend_from_slice(text.as_bytes());
    }
}

/// Methods that write a number as it is.
macro_rules! pack_numbers {
    ($($method:ident: $type:ty),* $(,)?) => {
        $(fn $method(self, v: $type) -> Result<(), PackedError> {
            self.bytes.extend(v.to_le_bytes());
            Ok(())
        })*
    };
}

impl<'a> ser::Serializer for &'a mut Packer {
    type Ok = ();
    type Error = PackedError;
    type SerializeSeq = Parts<'a>;
    type SerializeTuple = Parts<'a>;
    type SerializeTupleStruct = Parts<'a>;
    type SerializeTupleVariant = Parts<'a>;
    type SerializeMap = Parts<'a>;
    type SerializeStruct = Parts<'a>;
    type SerializeStructVariant = Parts<'a>;

    pack_numbers! {
        serialize_i8: i8, serialize_i16: i16, serialize_i32: i32, serialize_i64: i64,
        serialize_u8: u8, serialize_u16: u16, serialize_u32: u32, serialize_u64: u64,
        serialize_f32: f32, serialize_f64: f64,
    }

    fn serialize_bool(self, v: bool) -> Result<(), PackedError> {
        self.serialize_u8(u8::from(v))
    }

    fn serialize_char(self, v: char) -> Result<(), PackedError> {
        self.serialize_u32(u32::from(v))
    }

    fn serialize_str(self, v: &str) -> Result<(), PackedError> {
        self.text(v);
        Ok(())
    }

    fn serialize_bytes(self, v: &[u8]) -> Result<(), PackedError> {
        self.length(v.len());
        self.bytes.extend_from_slice(v);
        Ok(())
    }

    fn serialize_none(self) -> Result<(), PackedError> {
        self.serialize_bool(false)
    }

    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), PackedError> {
        self.bytes.push(1);
        value.serialize(self)
    }

    fn serialize_unit(self) -> Result<(), PackedError> {
        Ok(())
    }

    fn serialize_unit_struct(self, _name: &'static str) -> Result<(), PackedError> {
        Ok(())
    }

    fn serialize_unit_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
    ) -> Result<(), PackedError> {
        self.serialize_str(variant)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _name: &'static str,
        value: &T,
    ) -> Result<(), PackedError> {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _name: &'static str,
        _index: u32,
        variant: &'static str,
        value: &T,
    ) -> Result<(), PackedError> {
        self.text(variant);
        value.serialize(self)
    }

    fn serialize_seq(self, len: Option<usize>) -> Result<Parts<'a>, PackedError> {
        self.length(len.ok_or_else(|| PackedError::Value("a list of unknown length".into()))?);
        Ok(Parts(self))
    }

    fn serialize_tuple(self, _len: usize) -> Result<Parts<'a>, PackedError> {
        Ok(Parts(self))
    }

    fn serialize_tuple_struct(self, _name: &'static str, _len: usize) -> Result<Parts<'a>, PackedError> {
        Ok(Parts(self))
    }

    fn serialize_tuple_variant(
        self,
        _name: &'static str,
        _index: u32,
        variant: &'static str,
        _len: usize,
    ) -> Result<Parts<'a>, PackedError> {
        self.text(variant);
        Ok(Parts(self))
    }

    fn serialize_map(self, len: Option<usize>) -> Result<Parts<'a>, PackedError> {
        self.serialize_seq(len)
    }

    fn serialize_struct(self, _name: &'static str, len: usize) -> Result<Parts<'a>, PackedError> {
        self.serialize_seq(Some(len))
    }

    fn serialize_struct_variant(
        self,
        _name: &'static str,
        _index: u32,
        variant: &'static str,
        len: usize,
    ) -> Result<Parts<'a>, PackedError> {
        self.text(variant);
        self.serialize_seq(Some(len))
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

/// The parts of a value, one after the other.
struct Parts<'a>(&'a mut Packer);

/// Values without names of their own.
macro_rules! pack_elements {
    ($($kind:ident: $method:ident),* $(,)?) => {
        $(impl ser::$kind for Parts<'_> {
            type Ok = ();
            type Error = PackedError;

            fn $method<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), PackedError> {
                value.serialize(&mut *self.0)
            }

            fn end(self) -> Result<(), PackedError> {
                Ok(())
            }
        })*
    };
}

/// Values with the names of their fields.
macro_rules! pack_fields {
    ($($kind:ident),*) => {
        $(impl ser::$kind for Parts<'_> {
            type Ok = ();
            type Error = PackedError;

            fn serialize_field<T: Serialize + ?Sized>(&mut self, name: &'static str, value: &T) -> Result<(), PackedError> {
                self.0.text(name);
                value.serialize(&mut *self.0)
            }

            fn end(self) -> Result<(), PackedError> {
                Ok(())
            }
        })*
    };
}

pack_elements! {
    SerializeSeq: serialize_element,
    SerializeTuple: serialize_element,
    SerializeTupleStruct: serialize_field,
    SerializeTupleVariant: serialize_field,
}
pack_fields! { SerializeStruct, SerializeStructVariant }

impl ser::SerializeMap for Parts<'_> {
    type Ok = ();
    type Error = PackedError;

    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), PackedError> {
        key.serialize(&mut *self.0)
    }

    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), PackedError> {
        value.serialize(&mut *self.0)
    }

    fn end(self) -> Result<(), PackedError> {
        Ok(())
    }
}

struct Unpacker<'de> {
    rest: &'de [u8],
}

impl<'de> Unpacker<'de> {
    fn take(&mut self, n: usize) -> Result<&'de [u8], PackedError> {
        let (head, rest) =
            self.rest.split_at_checked(n).ok_or_else(|| PackedError::Value("it ends too early".into()))?;
        self.rest = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], PackedError> {
        Ok(self.take(N)?.try_into().expect("as many as were asked for"))
    }

    fn length(&mut self) -> Result<usize, PackedError> {
        let length = u64::from_le_bytes(self.array()?);
        usize::try_from(length).or(Err(PackedError::Value("a length beyond any memory".into())))
    }

    fn text(&mut self) -> Result<&'de str, PackedError> {
        let length = self.length()?;
        std::str::from_utf8(self.take(length)?).or(Err(PackedError::Value("a text that is none".into())))
    }

    fn flag(&mut self) -> Result<bool, PackedError> {
        match self.take(1)? {
            [0] => Ok(false),
            [1] => Ok(true),
            _ => Err(PackedError::Value("a flag that is neither true nor false".into())),
        }
    }
}

/// Methods that read a number as it is.
macro_rules! unpack_numbers {
    ($($method:ident, $visit:ident: $type:ty),* $(,)?) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
            visitor.$visit(<$type>::from_le_bytes(self.array()?))
        })*
    };
}

impl<'de> de::Deserializer<'de> for &mut Unpacker<'de> {
    type Error = PackedError;

    unpack_numbers! {
        deserialize_i8, visit_i8: i8, deserialize_i16, visit_i16: i16,
        deserialize_i32, visit_i32: i32, deserialize_i64, visit_i64: i64,
        deserialize_u8, visit_u8: u8, deserialize_u16, visit_u16: u16,
        deserialize_u32, visit_u32: u32, deserialize_u64, visit_u64: u64,
        deserialize_f32, visit_f32: f32, deserialize_f64, visit_f64: f64,
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, PackedError> {
        Err(PackedError::Value("a value of unknown type".into()))
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, PackedError> {
        Err(PackedError::Value("a field that is not known".into()))
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        visitor.visit_bool(self.flag()?)
    }

    fn deserialize_char<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        let code = u32::from_le_bytes(self.array()?);
        visitor.visit_char(char::from_u32(code).ok_or(PackedError::Value("a character that is none".into()))?)
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        visitor.visit_borrowed_str(self.text()?)
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        self.deserialize_str(visitor)
    }

    fn deserialize_identifier<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        self.deserialize_str(visitor)
    }

    fn deserialize_bytes<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        let length = self.length()?;
        visitor.visit_borrowed_bytes(self.take(length)?)
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        self.deserialize_bytes(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        if self.flag()? { visitor.visit_some(self) } else { visitor.visit_none() }
    }

    fn deserialize_unit<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        visitor.visit_unit()
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(self, _: &str, visitor: V) -> Result<V::Value, PackedError> {
        visitor.visit_unit()
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &str,
        visitor: V,
    ) -> Result<V::Value, PackedError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        let left = self.length()?;
        visitor.visit_seq(Elements { from: self, left })
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, left: usize, visitor: V) -> Result<V::Value, PackedError> {
        visitor.visit_seq(Elements { from: self, left })
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        left: usize,
        visitor: V,
    ) -> Result<V::Value, PackedError> {
        visitor.visit_seq(Elements { from: self, left })
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, PackedError> {
        let left = self.length()?;
        visitor.visit_map(Elements { from: self, left })
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, PackedError> {
        self.deserialize_map(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, PackedError> {
        visitor.visit_enum(self)
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

/// The elements of a list or the fields of a value that are still to come.
struct Elements<'a, 'de> {
    from: &'a mut Unpacker<'de>,
    left: usize,
}

impl Elements<'_, '_> {
    /// Whether there is another one; counts it.
    fn step(&mut self) -> bool {
        let is_more = self.left > 0;
        self.left = self.left.saturating_sub(1);
        is_more
    }
}

impl<'de> de::SeqAccess<'de> for Elements<'_, 'de> {
    type Error = PackedError;

    fn next_element_seed<S: DeserializeSeed<'de>>(
        &mut self,
        seed: S,
    ) -> Result<Option<S::Value>, PackedError> {
        if self.step() { seed.deserialize(&mut *self.from).map(Some) } else { Ok(None) }
    }

    /// No more than there are bytes, whatever the length says.
    fn size_hint(&self) -> Option<usize> {
        Some(self.left.min(self.from.rest.len()))
    }
}

impl<'de> de::MapAccess<'de> for Elements<'_, 'de> {
    type Error = PackedError;

    fn next_key_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<Option<S::Value>, PackedError> {
        if self.step() { seed.deserialize(&mut *self.from).map(Some) } else { Ok(None) }
    }

    fn next_value_seed<S: DeserializeSeed<'de>>(&mut self, seed: S) -> Result<S::Value, PackedError> {
        seed.deserialize(&mut *self.from)
    }
}

impl<'de> de::EnumAccess<'de> for &mut Unpacker<'de> {
    type Error = PackedError;
    type Variant = Self;

    fn variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<(S::Value, Self), PackedError> {
        let name = self.text()?;
        let variant = seed.deserialize(IntoDeserializer::<PackedError>::into_deserializer(name))?;
        Ok((variant, self))
    }
}

impl<'de> de::VariantAccess<'de> for &mut Unpacker<'de> {
    type Error = PackedError;

    fn unit_variant(self) -> Result<(), PackedError> {
        Ok(())
    }

    fn newtype_variant_seed<S: DeserializeSeed<'de>>(self, seed: S) -> Result<S::Value, PackedError> {
        seed.deserialize(self)
    }

    fn tuple_variant<V: Visitor<'de>>(self, left: usize, visitor: V) -> Result<V::Value, PackedError> {
        visitor.visit_seq(Elements { from: self, left })
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, PackedError> {
        de::Deserializer::deserialize_map(self, visitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::{Deserialize, Serialize};
    use std::collections::BTreeMap;

    const NAME: &str = "thing 1";

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    enum Kind {
        Plain,
        Wrapped(i64),
        Pair(u8, f32),
        Named { slab: usize, up: bool },
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    struct Thing {
        values: Vec<f64>,
        kinds: Vec<Kind>,
        name: String,
        letter: char,
        maybe: [Option<u32>; 2],
        table: BTreeMap<String, (i8, i16, i32, u16)>,
        nothing: (),
    }

    fn thing() -> Thing {
        Thing {
            values: vec![0.1, -0.0, f64::INFINITY, 1e-300, f64::MAX],
            kinds: vec![
                Kind::Plain,
                Kind::Wrapped(-5),
                Kind::Pair(7, 0.5),
                Kind::Named { slab: 3, up: true },
            ],
            name: "größe".into(),
            letter: 'ß',
            maybe: [None, Some(9)],
            table: [("a".into(), (-1, -2, -3, 4))].into(),
            nothing: (),
        }
    }

    #[test]
    fn every_kind_of_value_is_read_back_bit_for_bit() {
        let read: Thing = from_bytes(NAME, &to_bytes(NAME, &thing()).unwrap()).unwrap();
        assert_eq!(read, thing());
        assert_eq!(read.values[1].to_bits(), (-0.0_f64).to_bits());
    }

    #[test]
    fn numbers_take_their_eight_bytes() {
        let few = to_bytes(NAME, &vec![1.5; 10]).unwrap().len();
        assert_eq!(to_bytes(NAME, &vec![1.5; 1010]).unwrap().len() - few, 8000);
    }

    #[test]
    fn a_damaged_file_is_refused_whichever_byte_is_damaged() {
        let bytes = to_bytes(NAME, &thing()).unwrap();
        for i in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[i] ^= 0x40;
            assert!(from_bytes::<Thing>(NAME, &damaged).is_err(), "byte {i}");
            assert!(from_bytes::<Thing>(NAME, &bytes[..i]).is_err(), "first {i} bytes");
        }
        let longer = [&bytes[..], b"x"].concat();
        assert!(matches!(from_bytes::<Thing>(NAME, &longer), Err(PackedError::Length { .. })));
    }

    #[test]
    fn a_file_of_another_version_or_type_is_refused() {
        let bytes = to_bytes(NAME, &thing()).unwrap();
        let foreign = from_bytes::<Thing>("thing 2", &bytes).unwrap_err();
        assert_eq!(foreign.to_string(), "not a thing 2 of this version of lumenfab");
        #[derive(Debug, Deserialize)]
        struct Other {
            #[expect(dead_code, reason = "only read")]
            values: Vec<f64>,
        }
        let message = from_bytes::<Other>(NAME, &bytes).unwrap_err().to_string();
        assert!(message.contains("a field that is not known"), "{message}");
        assert!(matches!(
            from_bytes::<u8>(NAME, &to_bytes(NAME, &3_u16).unwrap()),
            Err(PackedError::Value(_))
        ));
    }

    #[test]
    fn a_length_beyond_the_file_asks_for_no_memory() {
        // Whole and with its right hash, but a list that says it has 2^60 elements.
        let mut bytes = to_bytes(NAME, &(1_u64 << 60)).unwrap();
        assert!(matches!(from_bytes::<Vec<f64>>(NAME, &bytes), Err(PackedError::Value(_))));
        assert!(matches!(from_bytes::<String>(NAME, &bytes), Err(PackedError::Value(_))));
        // A damaged number of bytes.
        let start = heading(NAME).len();
        bytes[start + 7] = 0x7f;
        assert!(matches!(from_bytes::<u64>(NAME, &bytes), Err(PackedError::Length { .. })));
    }
}
