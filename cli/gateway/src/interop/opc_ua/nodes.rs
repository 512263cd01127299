//! The nodes: a folder for each part of the machine, with a read-only variable for each quantity.

use std::{collections::BTreeSet, time::SystemTime};

use opcua::{
    nodes::VariableBuilder,
    server::{ServerHandle, address_space::AddressSpace, node_manager::memory::SimpleNodeManager},
    types::{
        DataTypeId, NodeId, NumericRange, ObjectId, QualifiedName, StatusCode, VariableTypeId,
    },
};

use super::{
    super::quantities::{Kind, Quantity, Shape, quantities},
    NAMESPACE,
    values::value,
};
use crate::published::Published;

/// The root folder and prefix of folder identifiers.
const ROOT: &str = "volcomp";

/// Creates the nodes. Each reads the latest state on access.
///
/// # Errors
/// The server was built without the node manager for them.
pub(super) fn fill(
    handle: &ServerHandle,
    shape: &Shape,
    published: &Published,
) -> Result<(), String> {
    let managers = handle.node_managers();
    let manager = managers.get_of_type::<SimpleNodeManager>();
    let namespace = handle.get_namespace_index(NAMESPACE);
    let (manager, namespace) = (manager.zip(namespace))
        .ok_or_else(|| format!("the server has no namespace {NAMESPACE}"))?;
    let mut space = manager.address_space().write();
    let mut folders = Folders {
        namespace,
        made: BTreeSet::new(),
    };
    for quantity in quantities(shape) {
        let folder = folders.of(&mut space, &quantity.folder());
        let node = NodeId::new(namespace, quantity.key.clone());
        let name = quantity.name();
        VariableBuilder::new(&node, QualifiedName::new(namespace, name.clone()), name)
            .description(description(&quantity))
            .data_type(data_type(quantity.kind))
            .has_type_definition(VariableTypeId::BaseDataVariableType)
            .component_of(folder)
            .insert(&mut *space);
        let published = published.clone();
        manager
            .inner()
            .add_read_callback(node, move |range, stamps, _| {
                if !matches!(range, NumericRange::None) {
                    return Err(StatusCode::BadIndexRangeNoData);
                }
                let reading = quantity.read(&published.latest());
                Ok(value(reading, SystemTime::now(), stamps))
            });
    }
    Ok(())
}

/// The folders created so far.
struct Folders {
    namespace: u16,
    made: BTreeSet<String>,
}

impl Folders {
    /// The folder of this path; created if it is missing.
    fn of(&mut self, space: &mut AddressSpace, path: &[&str]) -> NodeId {
        let mut above = NodeId::from(ObjectId::ObjectsFolder);
        let mut whole = String::new();
        for name in std::iter::once(&ROOT).chain(path) {
            if !whole.is_empty() {
                whole.push('/');
            }
            whole.push_str(name);
            let node = NodeId::new(self.namespace, whole.clone());
            if self.made.insert(whole.clone()) {
                space.add_folder(
                    &node,
                    QualifiedName::new(self.namespace, *name),
                    *name,
                    &above,
                );
            }
            above = node;
        }
        above
    }
}

fn data_type(kind: Kind) -> DataTypeId {
    match kind {
        Kind::Number(_) => DataTypeId::Double,
        Kind::Whole | Kind::Count => DataTypeId::UInt64,
        Kind::Truth => DataTypeId::Boolean,
        Kind::Text => DataTypeId::String,
    }
}

/// Description of a quantity, with its unit.
fn description(quantity: &Quantity) -> String {
    match quantity.kind {
        Kind::Number(unit) => format!("{}, {}", quantity.help, unit.symbol()),
        _ => quantity.help.to_owned(),
    }
}
