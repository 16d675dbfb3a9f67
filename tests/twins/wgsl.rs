//! All WGSL, judged without a device: it parses, it is valid, and every shared struct lies in memory as in Rust.

use naga::valid::{Capabilities, ValidationFlags, Validator};
use welkin_shaders::gpu::view_kernels::{LIGHT_KERNELS, SERVER_KERNELS, VIEW_KERNELS, VIEW_STRUCTS, reflect};
use welkin_shaders::gpu::{Bind, MODULES};
use welkin_shaders::wgsl;

fn parsed(name: &str) -> naga::Module {
    let source = wgsl::source(name).unwrap_or_else(|| panic!("{name} uses a module that isn't there"));
    naga::front::wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{name}:\n{}", e.emit_to_string(&source)))
}

/// Modules with entry points. Others may use what only these bind: they are judged within them.
fn stages() -> impl Iterator<Item = &'static wgsl::Module> {
    MODULES.iter().filter(|m| m.text.contains("@compute"))
}

#[test]
fn every_module_is_part_of_a_stage() {
    let forms = stages().flat_map(|m| [false, true].map(|subgroups| wgsl::source_for(m.name, subgroups)));
    let sources: Vec<String> = forms.flatten().collect();
    for module in MODULES {
        assert!(
            sources.iter().any(|s| s.contains(module.text)),
            "no stage uses {}",
            module.name
        );
    }
}

#[test]
fn every_module_is_valid() {
    for module in stages() {
        let parsed = parsed(module.name);
        // No capability beyond WebGPU's own is granted.
        Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&parsed)
            .unwrap_or_else(|e| panic!("{}: {e:?}", module.name));
    }
}

#[test]
fn forms_for_subgroups_are_valid_and_ask_for_nothing_else() {
    for module in stages() {
        let source = wgsl::source_for(module.name, true).expect("a source");
        if source == wgsl::source(module.name).expect("a source") {
            continue;
        }
        let parsed = naga::front::wgsl::parse_str(&source)
            .unwrap_or_else(|e| panic!("{}:\n{}", module.name, e.emit_to_string(&source)));
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::SUBGROUP);
        validator
            .subgroup_stages(naga::valid::ShaderStages::COMPUTE)
            .subgroup_operations(naga::valid::SubgroupOperationSet::all())
            .validate(&parsed)
            .unwrap_or_else(|e| panic!("{}: {e:?}", module.name));
    }
    for (plain, other) in wgsl::BY_SUBGROUPS {
        let functions = |name: &str| -> Vec<String> {
            let module = wgsl::module(name).expect("a module");
            let lines = module.text.lines().filter(|line| line.starts_with("fn "));
            lines.map(str::to_owned).collect()
        };
        assert_eq!(functions(plain), functions(other), "{other} stands in for {plain}");
    }
}

#[test]
fn every_file_is_a_module() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../shaders/wgsl");
    for kind in std::fs::read_dir(&folder).expect("the folder of WGSL") {
        let kind = kind.expect("an entry").path();
        for file in std::fs::read_dir(&kind).expect("a folder") {
            let file = file.expect("an entry").path();
            let name = file.strip_prefix(&folder).expect("inside").with_extension("");
            let name = name.to_str().expect("a plain name");
            assert!(wgsl::module(name).is_some(), "{name} is a file that no module names");
        }
    }
}

#[test]
fn stages_stay_inside_webgpus_default_limits() {
    for module in stages() {
        let parsed = parsed(module.name);
        for entry in &parsed.entry_points {
            let [x, y, z] = entry.workgroup_size;
            assert!(
                x * y * z <= 256 && z <= 64,
                "{}: workgroup of {x} x {y} x {z}",
                module.name
            );
        }
        let storage = parsed
            .global_variables
            .iter()
            .filter(|(_, v)| matches!(v.space, naga::AddressSpace::Storage { .. }));
        // A module may hold several entry points that bind different buffers at the same places: places count.
        let mut places: Vec<_> = storage
            .filter_map(|(_, v)| v.binding.as_ref().map(|b| b.binding))
            .collect();
        places.sort_unstable();
        places.dedup();
        assert!(places.len() <= 8, "{}: {} storage buffers", module.name, places.len());
        let workgroup: u32 = parsed
            .global_variables
            .iter()
            .filter(|(_, v)| v.space == naga::AddressSpace::WorkGroup)
            .map(|(_, v)| parsed.types[v.ty].inner.size(parsed.to_ctx()))
            .sum();
        assert!(
            workgroup <= 16_384,
            "{}: {workgroup} bytes of workgroup memory",
            module.name
        );
    }
}

#[test]
fn structs_lie_in_memory_as_in_rust() {
    let mut layouts: Vec<_> = MODULES.iter().flat_map(|m| m.structs).collect();
    layouts.sort_by_key(|l| l.name);
    layouts.dedup_by_key(|l| l.name);
    let mut unchecked: Vec<&str> = layouts.iter().map(|l| l.name).collect();
    for module in stages() {
        let parsed = parsed(module.name);
        for layout in &layouts {
            let Some((_, found)) = parsed
                .types
                .iter()
                .find(|(_, t)| t.name.as_deref() == Some(layout.name))
            else {
                continue;
            };
            let naga::TypeInner::Struct { members, span } = &found.inner else {
                panic!("{} is no struct", layout.name);
            };
            assert_eq!(*span as usize, layout.size, "size of {}", layout.name);
            assert_eq!(members.len(), layout.members.len(), "fields of {}", layout.name);
            for (theirs, ours) in members.iter().zip(layout.members) {
                assert_eq!(theirs.name.as_deref(), Some(ours.name), "in {}", layout.name);
                let place = format!("{}.{}", layout.name, ours.name);
                assert_eq!(theirs.offset as usize, ours.offset, "offset of {place}");
                let size = parsed.types[theirs.ty].inner.size(parsed.to_ctx()) as usize;
                assert_eq!(size, ours.size, "size of {place}");
            }
            unchecked.retain(|name| *name != layout.name);
        }
    }
    assert!(unchecked.is_empty(), "no stage knows {unchecked:?}");
}

/// What is told to those who compile the view's kernels elsewhere is what the kernels say of themselves.
#[test]
fn kernels_of_the_view_bind_what_their_list_says() {
    for kernel in VIEW_KERNELS.iter().chain(LIGHT_KERNELS).chain(SERVER_KERNELS) {
        let source = wgsl::source(kernel.module).unwrap();
        let said = reflect(&source).unwrap();
        assert!(said.entries.iter().any(|(name, _)| name == kernel.entry), "{kernel:?}");
        let binds: Vec<Bind> = said.bindings.iter().map(|b| b.bind).collect();
        assert_eq!(binds, kernel.binds, "{}", kernel.name);
        for (n, binding) in said.bindings.iter().enumerate() {
            assert_eq!(binding.binding, n as u32, "{}", kernel.name);
            if let Some(uniform) = &binding.uniform {
                assert!(
                    VIEW_STRUCTS.iter().any(|s| s.name == uniform),
                    "{} is in no list",
                    uniform
                );
            }
        }
        let storage = binds.iter().filter(|b| **b != Bind::Uniform).count();
        assert!(storage <= 8, "{} binds {storage} storage buffers", kernel.name);
    }
}

#[test]
fn constants_have_one_value_everywhere() {
    let mut seen: std::collections::HashMap<&str, wgsl::Literal> = Default::default();
    for constant in MODULES.iter().flat_map(|m| m.constants.iter().copied().flatten()) {
        let first = seen.entry(constant.name).or_insert(constant.value);
        assert_eq!(*first, constant.value, "{} has two values", constant.name);
    }
}
