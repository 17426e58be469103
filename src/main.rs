//! The `esker` command.

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    if let Some(lacks) = esker::processor::lacks() {
        eprintln!("esker: {lacks}");
        return std::process::ExitCode::FAILURE;
    }
    esker::cli::main()
}
